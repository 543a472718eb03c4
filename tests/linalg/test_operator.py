"""SparseOperator: products with the matrix and its transpose, with and without a border."""

import jax
import jax.numpy as jnp
import jax.random as jr
import lineax as lx
import numpy as np
import pytest

from jaxwillmore.linalg import SparseOperator

from .systems import dense, random_blocks, random_border, sphere_pattern

PATTERN = sphere_pattern()


@pytest.fixture(scope="module", params=[0, 2], ids=["plain", "bordered"])
def operator(request):
    return SparseOperator(
        random_blocks(jr.key(0), PATTERN, 3),
        PATTERN,
        random_border(jr.key(1), PATTERN, 3, request.param),
    )


def test_products_are_the_dense_ones(operator):
    full = dense(operator)
    v = jr.normal(jr.key(2), operator.in_structure().shape)
    np.testing.assert_allclose(operator.mv(v), full @ v, atol=1e-13)
    np.testing.assert_allclose(operator.transpose().mv(v), full.T @ v, atol=1e-13)
    np.testing.assert_allclose(operator.T.T.mv(v), full @ v, atol=1e-13)


def test_the_transpose_is_the_linear_transpose(operator):
    v, w = jr.normal(jr.key(3), (2, *operator.in_structure().shape))
    (expected,) = jax.linear_transpose(operator.mv, v)(w)
    np.testing.assert_allclose(operator.transpose().mv(w), expected, atol=1e-13)


def test_lineax_learns_nothing_special_about_it(operator):
    assert not lx.is_symmetric(operator) and not lx.is_diagonal(operator)
    assert lx.linearise(operator) is operator and lx.materialise(operator) is operator
    assert operator.in_structure() == operator.out_structure()


def test_all_entries(operator):
    np.testing.assert_array_equal(operator.as_matrix(), dense(operator))
    np.testing.assert_array_equal(operator.transpose().as_matrix(), dense(operator).T)


def test_derivative_by_the_entries(operator):
    """d(w·Av)/dA is the outer product of w and v on the pattern."""
    fields = operator.data.shape[-1]
    v, w = jr.normal(jr.key(4), (2, *operator.in_structure().shape))
    n = PATTERN.n_nodes * fields
    slope = jax.grad(
        lambda data: jnp.vdot(w, SparseOperator(data, PATTERN, operator.border).mv(v))
    )(operator.data)
    V, W = v[:n].reshape(-1, fields), w[:n].reshape(-1, fields)
    expected = W[PATTERN.rows][:, :, None] * V[PATTERN.cols][:, None, :]
    np.testing.assert_allclose(slope, expected, atol=1e-14)

"""Block LU on the host against dense linear algebra."""

import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.linalg import SparseOperator
from jaxwillmore.linalg._direct import ColumnStructure, Pattern, SuperLU

from .systems import dense, random_blocks, sphere_pattern


def host_pattern(pattern) -> Pattern:
    return Pattern(
        *(np.asarray(a) for a in (pattern.indptr, pattern.cols, pattern.rows, pattern.order))
    )


@pytest.fixture(scope="module", params=[1, 3])
def case(request):
    pattern = sphere_pattern(0, 2)
    data = random_blocks(jr.key(0), pattern, request.param)
    structure = ColumnStructure(host_pattern(pattern), request.param)
    return pattern, data, structure, dense(SparseOperator(data, pattern))


def test_the_column_structure_is_the_permuted_matrix(case):
    pattern, data, structure, full = case
    fields = data.shape[-1]
    order = (np.asarray(pattern.order)[:, None] * fields + np.arange(fields)).ravel()
    A = structure.matrix(np.asarray(data))
    np.testing.assert_array_equal(A.toarray(), full[np.ix_(order, order)])
    assert A.has_sorted_indices


def test_permute_and_restore_are_inverse(case):
    pattern, data, structure, _ = case
    v = np.random.default_rng(0).normal(size=(pattern.n_nodes, data.shape[-1]))
    np.testing.assert_array_equal(structure.restore(structure.permute(v)), v)


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("columns", [(), (4,)])
def test_lu_solves_for_one_and_many_right_hand_sides(case, transpose, columns):
    pattern, data, structure, full = case
    n, fields = pattern.n_nodes, data.shape[-1]
    rhs = np.random.default_rng(1).normal(size=(n, fields, *columns))
    found = SuperLU(structure, np.asarray(data)).solve(rhs, transpose)
    expected = np.linalg.solve(full.T if transpose else full, rhs.reshape(n * fields, -1))
    np.testing.assert_allclose(found, expected.reshape(rhs.shape), atol=1e-12)


def test_a_zero_diagonal_is_pivoted():
    """Saddle points have one: the low pivot threshold must not forbid leaving the diagonal."""
    pattern = sphere_pattern(0, 1)
    data = random_blocks(jr.key(2), pattern, 2, diagonal=0.0)
    data = data.at[:, 1, 1].set(0.0).at[:, 0, 1].add(0.5).at[:, 1, 0].add(-0.5)
    full = dense(SparseOperator(data, pattern))
    rhs = np.random.default_rng(2).normal(size=(pattern.n_nodes, 2))
    found = SuperLU(ColumnStructure(host_pattern(pattern), 2), np.asarray(data)).solve(rhs, False)
    tolerance = 1e-13 * np.linalg.cond(full)
    np.testing.assert_allclose(
        found.ravel(), np.linalg.solve(full, rhs.ravel()), rtol=max(tolerance, 1e-9)
    )

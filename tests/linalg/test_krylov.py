"""The block Gauss–Seidel preconditioner and its extension to bordered matrices."""

import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.linalg import SparseOperator
from jaxwillmore.linalg._direct import ColumnStructure, SuperLU
from jaxwillmore.linalg._flexible import flexible_gmres
from jaxwillmore.linalg._groups import block_matrix
from jaxwillmore.linalg._krylov import Bordered, GaussSeidel

from .systems import dense, random_blocks, random_border, sphere_pattern
from .test_direct import host_pattern

# Two copies of a pair of fields, then a single field: five columns out of order on purpose.
GROUPS = (((0, 3), (1, 4)), ((2,),))
PATTERN = sphere_pattern(0, 2)
HOST = host_pattern(PATTERN)


def sweep(data, groups=GROUPS):
    return GaussSeidel(
        HOST, np.asarray(data), groups, lambda fields: ColumnStructure(HOST, fields), SuperLU
    )


@pytest.fixture(scope="module")
def data():
    return random_blocks(jr.key(0), PATTERN, 5)


def test_block_matrix_is_the_dense_one(data):
    full = dense(SparseOperator(data, PATTERN))
    np.testing.assert_array_equal(block_matrix(HOST, np.asarray(data)).toarray(), full)


def test_the_preconditioner_and_its_transpose_are_adjoint(data):
    apply, rng = sweep(data).apply, np.random.default_rng(0)
    for _ in range(3):
        v, w = rng.normal(size=(2, PATTERN.n_nodes * 5))
        assert apply(v, False) @ w == pytest.approx(v @ apply(w, True), rel=1e-12)


def test_one_sweep_solves_a_lower_triangular_system(data):
    """Equal copies, no coupling between them, none of the first group to the second."""
    blocks = np.zeros(data.shape)
    pair = np.asarray(data)[:, :2, :2]
    for copy in GROUPS[0]:
        blocks[:, np.array(copy)[:, None], np.array(copy)] = pair
    blocks[:, 2, :] = np.asarray(data)[:, 2, :]
    full = dense(SparseOperator(blocks, PATTERN))
    v = np.random.default_rng(1).normal(size=full.shape[0])
    for transpose in (False, True):
        A = full.T if transpose else full
        np.testing.assert_allclose(A @ sweep(blocks).apply(v, transpose), v, atol=1e-11)


def test_one_group_of_all_columns_is_the_inverse(data):
    v = np.random.default_rng(2).normal(size=PATTERN.n_nodes * 5)
    full = dense(SparseOperator(data, PATTERN))
    found = sweep(data, (((0, 1, 2, 3, 4),),)).apply(v, False)
    np.testing.assert_allclose(full @ found, v, atol=1e-11)


@pytest.mark.parametrize("transpose", [False, True])
def test_a_border_is_eliminated_exactly(data, transpose):
    """With the exact inverse of the nodal part the bordered preconditioner is the exact inverse."""
    border = random_border(jr.key(1), PATTERN, 5, 2)
    operator = SparseOperator(data, PATTERN, border)
    full = dense(operator)
    full = full.T if transpose else full
    bordered = Bordered(
        block_matrix(HOST, np.asarray(data)),
        *(np.asarray(a) for a in (border.columns, border.rows, border.corner)),
    )
    v = np.random.default_rng(3).normal(size=len(full))
    np.testing.assert_allclose(bordered.times(v, transpose), full @ v, atol=1e-12)
    np.testing.assert_allclose(bordered.sizes(v, transpose), abs(full) @ abs(v), rtol=1e-12)
    whole = sweep(data, (((0, 1, 2, 3, 4),),))
    solve = bordered.preconditioner(lambda u: whole.apply(u, transpose), transpose)
    np.testing.assert_allclose(full @ solve(v), v, atol=1e-10)


def test_a_right_hand_side_that_overflows_is_not_called_solved():
    found = flexible_gmres(lambda v: v, lambda v: v, np.full(4, 1e200), 1e-8)
    assert not found.converged and found.iterations == 0

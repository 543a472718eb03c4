"""Flexible GMRES: what it costs, when it stops, and what it takes for solved."""

import numpy as np
import pytest

from jaxwillmore.linalg._direct import ColumnStructure, SuperLU
from jaxwillmore.linalg._factorised import (
    NOT_CONVERGED,
    SINGULAR,
    SUCCESS,
    Backend,
    Factorised,
)
from jaxwillmore.linalg._flexible import MAX_ITERATIONS, RESTART, flexible_gmres

from .systems import diagonal_blocks, sphere_pattern
from .test_direct import host_pattern


def counted(function):
    def call(v):
        call.count += 1
        return function(v)

    call.count = 0
    return call


def system(n=200, spread=0.3):
    rng = np.random.default_rng(0)
    A = np.eye(n) + spread * rng.standard_normal((n, n)) / np.sqrt(n)
    return A, rng.standard_normal(n)


@pytest.mark.parametrize("rtol", [1e-2, 1e-6, 1e-12])
def test_every_iteration_takes_one_sweep_and_one_product(rtol):
    """And one product more, to see the true residual."""
    A, b = system()
    times, sweep = counted(A.__matmul__), counted(lambda v: v / np.diag(A))
    found = flexible_gmres(times, sweep, b, rtol)
    assert found.converged and np.linalg.norm(A @ found.x - b) <= rtol * np.linalg.norm(b)
    assert sweep.count == found.iterations < RESTART
    assert times.count == found.iterations + 1
    np.testing.assert_array_equal(found.residual, b - A @ found.x)


def test_the_preconditioner_may_change_from_sweep_to_sweep():
    A, b = system()
    scale = iter(np.linspace(1.0, 3.0, MAX_ITERATIONS))
    assert flexible_gmres(A.__matmul__, lambda v: next(scale) * v, b, 1e-10).converged


def test_rows_of_any_size_do_not_hide_the_true_residual():
    """Rows over seven powers of ten and a preconditioner that knows them: it is watched itself."""
    A, b = system()
    rows = 10.0 ** np.linspace(0, 7, len(b))
    b[10:] *= 1e-3
    found = flexible_gmres(lambda v: rows * (A @ v), lambda v: v / rows, b, 1e-8)
    assert found.converged and found.iterations < RESTART
    assert np.linalg.norm(rows * (A @ found.x) - b) < 1e-8 * np.linalg.norm(b)


def test_a_cycle_that_leads_nowhere_is_the_last():
    A, b = system(spread=0.0)
    shift = np.roll(A, 1, axis=0)  # a cyclic shift: no progress before iteration n
    found = flexible_gmres(shift.__matmul__, lambda v: v, b, 1e-8)
    assert not found.converged and found.iterations == RESTART


def test_all_iterations_together_are_limited():
    """Eigenvalues over four powers of ten: cycles that help, but too many of them."""
    rng = np.random.default_rng(1)
    A = np.diag(10.0 ** np.linspace(0, 4, 200))
    found = flexible_gmres(A.__matmul__, lambda v: v, rng.standard_normal(200), 1e-12)
    assert not found.converged and found.iterations <= MAX_ITERATIONS


def test_what_rounding_keeps_from_the_tolerance_is_not_thrown_away():
    """Products with a relative error of 1e-9: no 1e-12 to be had, but eight digits."""
    rng = np.random.default_rng(0)
    A, b = np.diag(np.linspace(1.0, 2.0, 200)), np.ones(200)
    found = flexible_gmres(
        lambda v: A @ v * (1 + 1e-9 * rng.normal(size=200)), lambda v: v, b, 1e-12
    )
    assert not found.converged and found.iterations < MAX_ITERATIONS
    np.testing.assert_allclose(found.x, np.linalg.solve(A, b), rtol=1e-7)


def test_nothing_asked_is_nothing_answered():
    A, b = system()
    found = flexible_gmres(A.__matmul__, lambda v: v, 0 * b, 1e-8)
    assert found.converged and found.iterations == 0 and not np.any(found.x)


def test_a_preconditioner_that_is_not_finite_fails_without_a_warning():
    A, b = system()
    assert not flexible_gmres(A.__matmul__, lambda v: np.nan * v, b, 1e-8).converged


# What counts as solved when the tolerance cannot be met.

PATTERN = host_pattern(sphere_pattern(1, 1))
GROUPS = (((0,), (1,)),)


def laplacian(shift: float, coupling=0.0) -> np.ndarray:
    """Two uncoupled graph Laplacians plus a multiple of the identity: constants are nearly lost."""
    rows, cols = PATTERN.rows, PATTERN.cols
    data = np.where(rows == cols, 0.0, -1.0)
    data[diagonal_blocks(sphere_pattern(1, 1))] = np.bincount(rows) - 1.0 + shift
    blocks = data[:, None, None] * np.eye(2)
    blocks[rows == cols] += coupling * np.array([[0.0, 1.0], [0.0, 0.0]])
    return blocks


def solve(data, rhs, rtol=1e-15, direct=True, transpose=False, factorise=SuperLU):
    empty = np.zeros((0, PATTERN.n_nodes, 2))
    matrix = Factorised(
        Backend(GROUPS, direct, factorise),
        PATTERN,
        lambda n_fields: ColumnStructure(PATTERN, n_fields),
        data,
        (empty, empty, np.zeros((0, 0))),
    )
    x, _, outcome = matrix.solve(rhs, transpose, rtol)
    return x, outcome, matrix


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("shift", [1e-2, 1e-5])
def test_a_residual_at_rounding_is_solved_whatever_was_asked(shift, transpose):
    """A relative residual of 1e-15 is not to be had; the solution has all digits that there are."""
    data = laplacian(shift, coupling=1e-3)
    rhs = np.random.default_rng(2).normal(size=PATTERN.n_nodes * 2)
    x, outcome, matrix = solve(data, rhs, 1e-17, transpose=transpose)
    assert outcome == SUCCESS
    full = np.stack([matrix._matrix.times(e, transpose) for e in np.eye(len(rhs))], axis=1)
    exact = np.linalg.solve(full, rhs)
    accuracy = 1e-14 * np.linalg.cond(full)
    np.testing.assert_allclose(x, exact, atol=accuracy * np.max(abs(exact)))


@pytest.mark.parametrize("lost", [1e-4, 1e-9])
def test_a_residual_above_rounding_is_not_solved_however_small(lost):
    """A solver that cannot reach one unknown leaves its right-hand side: not within 64 units of
    rounding, though the sizes of all terms hide it."""

    class Blind:
        def __init__(self, structure, data):
            self._lu, self.nbytes = SuperLU(structure, data), 0

        def solve(self, rhs, transpose):
            return self._lu.solve(rhs, transpose).reshape(rhs.shape) * seen

    blocks = np.zeros((len(PATTERN.rows), 2, 2))
    blocks[PATTERN.rows == PATTERN.cols] = np.diag([2.0, 1.0])
    seen, rhs = np.ones((PATTERN.n_nodes, 2)), np.ones((PATTERN.n_nodes, 2))
    seen[3, 1], rhs[3, 1] = 0.0, lost
    assert solve(blocks, rhs.reshape(-1), 1e-12, factorise=Blind)[1] == NOT_CONVERGED
    assert solve(blocks, rhs.reshape(-1), 1e-12)[1] == SUCCESS


@pytest.mark.parametrize("direct", [True, False])
def test_a_singular_matrix_is_refused(direct):
    """Constants in the kernel: LU may divide by a pivot of 1e-16, and x hides the right-hand side
    in its rounding. The old bound took that as solved up to a relative residual of 1e-3."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        _, outcome, _ = solve(laplacian(0.0), rng.normal(size=PATTERN.n_nodes * 2), 1e-10, direct)
        assert outcome in (SINGULAR, NOT_CONVERGED)


def test_a_nearly_singular_matrix_is_refused_above_a_relative_residual_of_1e_6():
    rng = np.random.default_rng(4)
    for shift in 10.0 ** -np.arange(6, 16):
        rhs = rng.normal(size=PATTERN.n_nodes * 2)
        x, outcome, matrix = solve(laplacian(shift, coupling=1.0), rhs, 1e-10)
        left = np.linalg.norm(matrix._matrix.times(x, False) - rhs) / np.linalg.norm(rhs)
        assert (outcome == SUCCESS) == (left <= 1e-6), (shift, left)

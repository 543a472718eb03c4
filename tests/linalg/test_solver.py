"""SparseSolver against dense solves: values, derivatives, batches, failures."""

import importlib.util

import jax
import jax.numpy as jnp
import jax.random as jr
import lineax as lx
import numpy as np
import pytest

from jaxwillmore.linalg import SparseOperator, SparseSolver
from jaxwillmore.linalg._flexible import RESTART
from jaxwillmore.linalg._host import HOST

from ..helpers import with_nan
from .systems import dense, diagonal_blocks, random_blocks, random_border, sphere_pattern

PATTERN, FIELDS = sphere_pattern(), 2
GROUPS = (((0,),), ((1,),))
needs_pardiso = pytest.mark.skipif(
    importlib.util.find_spec("pypardiso") is None, reason="needs the extra `fast`"
)
METHODS = [
    SparseSolver(GROUPS, 1e-13),
    SparseSolver((), 1e-13),
    SparseSolver(GROUPS, 1e-13, "direct"),
    SparseSolver((), 1e-13, "dense"),
    pytest.param("pardiso", marks=needs_pardiso),
]
NAMES = ["krylov", "no groups", "direct", "dense", "pardiso"]


@pytest.fixture
def solver(request):
    if request.param == "pardiso":
        return SparseSolver(GROUPS, 1e-13, "pardiso")
    return request.param


def operator_of(n_globals=0, key=0):
    return SparseOperator(
        random_blocks(jr.key(key), PATTERN, FIELDS),
        PATTERN,
        random_border(jr.key(key + 100), PATTERN, FIELDS, n_globals),
    )


@pytest.mark.parametrize("solver", METHODS, indirect=True, ids=NAMES)
@pytest.mark.parametrize("n_globals", [0, 2])
def test_solutions_are_the_dense_ones(solver, n_globals):
    operator = operator_of(n_globals)
    full = dense(operator)
    b = jr.normal(jr.key(1), (len(full),))
    for op, A in ((operator, full), (operator.transpose(), full.T)):
        x = lx.linear_solve(op, b, solver).value
        np.testing.assert_allclose(x, np.linalg.solve(A, b), atol=1e-11)


@pytest.mark.parametrize("solver", METHODS, indirect=True, ids=NAMES)
def test_derivatives_are_the_dense_ones(solver):
    """By the matrix and the right-hand side, forward and reverse, under jit."""
    operator = operator_of()
    full, w = dense(operator), jr.normal(jr.key(2), (PATTERN.n_nodes * FIELDS,))

    @jax.jit
    def f(data, b):
        return jnp.vdot(w, lx.linear_solve(SparseOperator(data, PATTERN), b, solver).value)

    b = jr.normal(jr.key(3), w.shape)
    d_data, d_b = jax.grad(f, argnums=(0, 1))(operator.data, b)
    adjoint, x = np.linalg.solve(full.T, w), np.linalg.solve(full, b)
    np.testing.assert_allclose(d_b, adjoint, atol=1e-11)
    outer = -np.outer(adjoint, x).reshape(PATTERN.n_nodes, FIELDS, PATTERN.n_nodes, FIELDS)
    expected = outer[np.asarray(PATTERN.rows), :, np.asarray(PATTERN.cols), :]
    np.testing.assert_allclose(d_data, expected, atol=1e-11)
    directions = jr.normal(jr.key(4), d_data.shape), jr.normal(jr.key(5), b.shape)
    _, forward = jax.jvp(f, (operator.data, b), directions)
    reverse = jnp.vdot(d_data, directions[0]) + jnp.vdot(d_b, directions[1])
    np.testing.assert_allclose(forward, reverse, rtol=1e-10)


def test_a_batch_equals_a_loop_even_when_it_outgrows_the_cache(monkeypatch):
    """The host keeps the last of nine matrices only, forward and reverse."""
    monkeypatch.setattr(HOST._entries, "_limit", 0)
    data = jnp.stack([random_blocks(jr.key(k), PATTERN, FIELDS) for k in range(9)])
    b = jr.normal(jr.key(1), (9, PATTERN.n_nodes * FIELDS))
    solver = SparseSolver(GROUPS, 1e-13)

    def one(data, b):
        return jnp.sum(lx.linear_solve(SparseOperator(data, PATTERN), b, solver).value ** 2)

    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(one, argnums=1)))(data, b)
    for k in range(9):
        full = dense(SparseOperator(data[k], PATTERN))
        x = np.linalg.solve(full, b[k])
        np.testing.assert_allclose(values[k], x @ x, rtol=1e-10)
        np.testing.assert_allclose(slopes[k], np.linalg.solve(full.T, 2 * x), atol=1e-10)


def test_a_dense_batch_is_one_program_without_callbacks():
    """All members at once, with nothing outside the compiled function."""
    data = jnp.stack([random_blocks(jr.key(k), PATTERN, FIELDS) for k in range(3)])
    b = jr.normal(jr.key(1), (3, PATTERN.n_nodes * FIELDS))

    def one(data, b):
        solver = SparseSolver((), 1e-13, "dense")
        solution = lx.linear_solve(SparseOperator(data, PATTERN), b, solver, throw=False)
        return jnp.sum(solution.value**2)

    assert "callback" not in jax.jit(jax.vmap(one)).lower(data, b).as_text()
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(one, argnums=1)))(data, b)
    for k in range(3):
        full = dense(SparseOperator(data[k], PATTERN))
        x = np.linalg.solve(full, b[k])
        np.testing.assert_allclose(values[k], x @ x, rtol=1e-10)
        np.testing.assert_allclose(slopes[k], np.linalg.solve(full.T, 2 * x), atol=1e-10)


def test_many_vectors_against_one_matrix():
    operator, solver = operator_of(), SparseSolver(GROUPS, 1e-13)
    b = jr.normal(jr.key(1), (3, PATTERN.n_nodes * FIELDS))
    state = solver.init(operator, {})
    x = jax.vmap(lambda b: lx.linear_solve(operator, b, solver, state=state).value)(b)
    np.testing.assert_allclose(x, np.linalg.solve(dense(operator), b.T).T, atol=1e-11)


# Failures.


@pytest.mark.parametrize("transposed", [False, True])
def test_the_whole_matrix_is_factorised_when_gmres_stalls(transposed):
    """Groups that ignore the strong coupling: a cycle of GMRES that leads nowhere, then LU."""
    pattern = sphere_pattern(1, 1)
    data = random_blocks(jr.key(0), pattern, 4, diagonal=0.0)
    strong = jnp.roll(jnp.eye(4), 1, axis=0) * 5
    data = data.at[diagonal_blocks(pattern)].add(strong[None] + 0.3 * jnp.eye(4)[None])
    operator = SparseOperator(data, pattern)
    operator = operator.transpose() if transposed else operator
    full = dense(operator)
    b = jr.normal(jr.key(1), (len(full),))
    groups = tuple(((k,),) for k in range(4))
    solution = lx.linear_solve(operator, b, SparseSolver(groups, 1e-12))
    assert int(solution.stats["iterations"]) > RESTART
    np.testing.assert_allclose(solution.value, np.linalg.solve(full, b), atol=1e-9)


def test_the_whole_matrix_is_factorised_when_a_group_is_singular():
    data = random_blocks(jr.key(0), PATTERN, FIELDS)
    data = data.at[:, 0, 0].set(0.0).at[:, 0, 1].add(4.0).at[:, 1, 0].add(4.0)
    data = jnp.where(
        jnp.isin(jnp.arange(len(data)), diagonal_blocks(PATTERN))[:, None, None],
        data,
        0.1 * data.at[:, 0, 1].add(-4.0).at[:, 1, 0].add(-4.0),
    )
    operator = SparseOperator(data, PATTERN)
    b = jr.normal(jr.key(1), (PATTERN.n_nodes * FIELDS,))
    x = lx.linear_solve(operator, b, SparseSolver(GROUPS, 1e-12)).value
    np.testing.assert_allclose(x, np.linalg.solve(dense(operator), b), atol=1e-10)


def result_of(data, b, method="krylov", transposed=False):
    operator = SparseOperator(data, PATTERN)
    operator = operator.transpose() if transposed else operator
    return lx.linear_solve(operator, b, SparseSolver(GROUPS, 1e-10, method), throw=False).result


@with_nan
@pytest.mark.parametrize(
    "method", ["krylov", "direct", "dense", pytest.param("pardiso", marks=needs_pardiso)]
)
def test_a_singular_matrix_is_reported(method):
    """One node without any entry; the failures of a solver are results, not crashes."""
    data = random_blocks(jr.key(0), PATTERN, FIELDS)
    lost = (PATTERN.rows == 3) | (PATTERN.cols == 3)
    data = jnp.where(lost[:, None, None], 0.0, data)
    b = jnp.ones(PATTERN.n_nodes * FIELDS)
    result = result_of(data, b, method)
    assert bool(result != lx.RESULTS.successful)
    if method != "pardiso":  # Pardiso perturbs small pivots and ends without convergence instead
        assert bool(result == lx.RESULTS.singular)
    with pytest.raises(Exception, match="singular|breakdown|Breakdown|Krylov"):
        lx.linear_solve(SparseOperator(data, PATTERN), b, SparseSolver(GROUPS, 1e-10, method))


@with_nan
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["matrix", "vector"])
@pytest.mark.parametrize("method", ["krylov", "dense"])
def test_values_that_are_not_finite_are_reported(bad, where, method):
    data = random_blocks(jr.key(0), PATTERN, FIELDS)
    b = jnp.ones(PATTERN.n_nodes * FIELDS)
    if where == "matrix":
        data = data.at[5, 0, 1].set(bad)
    else:
        b = b.at[4].set(bad)
    assert bool(result_of(data, b, method) == lx.RESULTS.nonfinite_input)


def test_nothing_asked_is_nothing_answered():
    operator = operator_of()
    b = jnp.zeros(PATTERN.n_nodes * FIELDS)
    x = lx.linear_solve(operator, b, SparseSolver(GROUPS, 1e-12)).value
    np.testing.assert_array_equal(x, 0.0)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="`method` must be one of"):
        SparseSolver(method="cholesky")
    pattern = sphere_pattern(2, 2)  # 642 nodes
    large = SparseOperator(jnp.zeros((pattern.n_blocks, 4, 4)), pattern)
    with pytest.raises(ValueError, match="at most 2,500 unknowns, and there are 2,568: .* 0.11 GB"):
        lx.linear_solve(large, jnp.ones(2568), SparseSolver(method="dense"))
    matrix = lx.MatrixLinearOperator(jnp.eye(3))
    with pytest.raises(ValueError, match="got MatrixLinearOperator"):
        lx.linear_solve(matrix, jnp.ones(3), SparseSolver())


def test_pardiso_is_explained_where_it_is_missing(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'jaxwillmore\[fast\]'"):
        SparseSolver(method="pardiso")

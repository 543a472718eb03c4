"""root_find through SparseNewton: dense Newton's root, its derivatives, and its failures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import jax.tree_util as jtu
import lineax as lx
import numpy as np
import optimistix as optx
import pytest

from jaxwillmore.linalg import AbstractSparseSystem, SparseNewton, SparseSolver

from ..helpers import with_nan
from .systems import FIELDS, PATTERN, dense, sinh_system

GROUPS = (((0,),), ((1,),))
LINEAR = SparseSolver(GROUPS, 1e-13)
DENSE = SparseSolver((), 1e-13, "dense")


def residual(y, system):
    return system.residual(y)


def find(system, y0=None, *, solver=LINEAR, adjoint=LINEAR, linear=False, max_steps=30, throw=True):
    y0 = jnp.zeros(system.b.shape) if y0 is None else y0
    return optx.root_find(
        residual,
        SparseNewton(1e-12, solver, linear=linear),
        y0,
        system,
        max_steps=max_steps,
        adjoint=optx.ImplicitAdjoint(adjoint),
        throw=throw,
    )


def with_parameters(system, p, b):
    return eqx.tree_at(lambda s: (s.p, s.b), system, (p, b))


solve = eqx.filter_jit(find)


@pytest.mark.parametrize("n_globals", [0, 1])
def test_the_root_and_its_derivatives(n_globals):
    """Against the implicit function theorem with the dense Jacobian, and finite differences."""
    system = sinh_system(n_globals)
    w = jr.normal(jr.key(2), system.b.shape)

    def f(p, b):
        y = find(with_parameters(system, p, b)).value
        return jnp.vdot(w, y), y

    both = jax.jit(jax.value_and_grad(f, argnums=(0, 1), has_aux=True))
    (_, y), (d_p, d_b) = both(system.p, system.b)
    J = np.asarray(jax.jacfwd(system.residual)(y))
    np.testing.assert_allclose(dense(system.jacobian(y)), J, atol=1e-13)
    np.testing.assert_allclose(system.residual(y), 0.0, atol=1e-12)
    adjoint = np.linalg.solve(J.T, w)
    np.testing.assert_allclose(d_b, adjoint, atol=1e-10)
    np.testing.assert_allclose(d_p, -adjoint @ jnp.sinh(y), rtol=1e-10)

    tangent = jr.normal(jr.key(3), system.b.shape)
    forward = jax.jit(lambda *at: jax.jvp(lambda *a: f(*a)[0], at, (jnp.asarray(0.3), tangent))[1])
    slope = forward(system.p, system.b)
    np.testing.assert_allclose(slope, 0.3 * d_p + jnp.vdot(d_b, tangent), rtol=1e-10)

    def central(h):
        up, down = (both(system.p + 0.3 * s, system.b + s * tangent)[0][0] for s in (h, -h))
        return float(up - down) / (2 * h)

    richardson = (4 * central(5e-4) - central(1e-3)) / 3
    np.testing.assert_allclose(slope, richardson, rtol=1e-9)


@pytest.mark.parametrize("solver", [LINEAR, DENSE], ids=["krylov", "dense"])
def test_members_of_a_batch_have_their_own_roots_and_gradients(solver):
    """They stop after different numbers of steps, with different Jacobians."""
    system = sinh_system()
    ps, b = jnp.array([0.0, 0.5, 5.0]), 3 * system.b

    def f(p):
        y = find(with_parameters(system, p, b), solver=solver, adjoint=solver).value
        return jnp.sum(y**2), y

    (_, ys), slopes = jax.jit(jax.vmap(jax.value_and_grad(f, has_aux=True)))(ps)
    A = dense(system.operator)
    for p, y, slope in zip(ps, np.asarray(ys), slopes, strict=True):
        np.testing.assert_allclose(A @ y + p * np.sinh(y), b, atol=1e-11)
        adjoint = np.linalg.solve((A + p * np.diag(np.cosh(y))).T, 2 * y)
        np.testing.assert_allclose(slope, -adjoint @ np.sinh(y), rtol=1e-9)


def test_second_derivatives():
    system = sinh_system()

    @jax.jit
    def f(p):
        return jnp.sum(find(with_parameters(system, p, system.b)).value ** 2)

    slope = jax.jit(jax.grad(f))
    second = jax.jacfwd(slope)(system.p)
    h = 1e-3
    differences = [
        (slope(system.p + k * h) - slope(system.p - k * h)) / (2 * k * h) for k in (1, 2)
    ]
    np.testing.assert_allclose(second, (4 * differences[0] - differences[1]) / 3, rtol=1e-8)


def test_counts_are_reported_and_a_jacobian_is_kept_while_it_works():
    nearly_linear = solve(sinh_system(p=1e-3))
    assert int(nearly_linear.stats["jacobians"]) == 1 < int(nearly_linear.stats["num_steps"])
    curved = sinh_system(p=5.0)
    curved = solve(with_parameters(curved, curved.p, 50 * curved.b))
    assert 1 < int(curved.stats["jacobians"]) <= int(curved.stats["num_steps"])
    assert int(curved.stats["linear_iterations"]) > 0


def test_a_linear_system_takes_one_iteration():
    system = sinh_system(p=0.0)
    solution = solve(system, linear=True, max_steps=2)
    assert int(solution.stats["num_steps"]) == 1
    expected = np.linalg.solve(dense(system.operator), system.b)
    np.testing.assert_allclose(solution.value, expected, atol=1e-11)


def test_the_root_does_not_depend_on_the_start():
    """A start where the full Newton step overshoots by e⁶: damping brings it back."""
    system = sinh_system(p=2.0)
    far = solve(system, jnp.full(system.b.shape, 6.0), max_steps=60)
    np.testing.assert_allclose(far.value, solve(system).value, atol=1e-11)


# Failures, each with its name.


def test_too_few_steps():
    solution = solve(sinh_system(p=5.0), max_steps=2, throw=False)
    assert bool(solution.result == optx.RESULTS.nonlinear_max_steps_reached)


@with_nan
def test_a_start_that_is_not_finite():
    system = sinh_system()
    solution = solve(system, jnp.full(system.b.shape, jnp.nan), throw=False)
    assert bool(solution.result != optx.RESULTS.successful)


@with_nan
def test_a_singular_jacobian():
    system = sinh_system(p=0.0)
    empty = eqx.tree_at(lambda s: s.operator.data, system, jnp.zeros_like(system.operator.data))
    solution = solve(empty, throw=False)
    assert bool(solution.result == optx.RESULTS.singular)


class NoRoot(AbstractSparseSystem):
    """1 + y² = 0, with the Jacobian of its square root: Newton wanders and never arrives."""

    system: AbstractSparseSystem

    @property
    def pattern(self):
        return self.system.pattern

    @property
    def n_globals(self):
        return 0

    def residual(self, y):
        return 1.0 + y**2

    def jacobian(self, y):
        return eqx.tree_at(
            lambda op: op.data, self.system.operator, _diagonal(2 * y.reshape(-1, FIELDS))
        )


def _diagonal(values):
    at = np.flatnonzero(np.asarray(PATTERN.rows) == np.asarray(PATTERN.cols))
    zero = jnp.zeros((PATTERN.n_blocks, FIELDS, FIELDS))
    return zero.at[at].set(jax.vmap(jnp.diag)(values))


def test_a_system_without_a_root():
    system = NoRoot(sinh_system())
    solution = optx.root_find(
        residual,
        SparseNewton(1e-10, LINEAR),
        jr.normal(jr.key(1), (PATTERN.n_nodes * FIELDS,)),
        system,
        max_steps=40,
        throw=False,
    )
    assert bool(solution.result != optx.RESULTS.successful)


def test_the_system_must_be_the_argument():
    with pytest.raises(ValueError, match="needs `args` to be an AbstractSparseSystem"):
        optx.root_find(lambda y, _: y, SparseNewton(1e-10, LINEAR), jnp.ones(3), None)


# The private layout that the adjoint rests on.


class Spy(lx.AbstractLinearSolver):
    """Looks at the operator that Optimistix hands to the solver of its implicit adjoint."""

    inner: SparseSolver
    seen: list = eqx.field(static=True)

    def init(self, operator, options):
        leaves = jtu.tree_leaves(
            getattr(operator, "args", None), is_leaf=lambda a: isinstance(a, AbstractSparseSystem)
        )
        systems = [leaf for leaf in leaves if isinstance(leaf, AbstractSparseSystem)]
        self.seen.append((type(operator), len(systems), jnp.shape(getattr(operator, "x", None))))
        return self.inner.init(operator, options)

    def compute(self, state, vector, options):
        return self.inner.compute(state, vector, options)

    def transpose(self, state, options):
        return self.inner.transpose(state, options)

    def conj(self, state, options):
        return self.inner.conj(state, options)

    def assume_full_rank(self):
        return True


class _Seen(list):
    __hash__ = object.__hash__  # pyright: ignore[reportAssignmentType]


def test_optimistix_still_hands_over_the_system_with_the_jacobian_at_the_root():
    """If this fails after an update of Optimistix, `linalg._solver._assembled` must follow it."""
    system, seen = sinh_system(), _Seen()
    spy = Spy(LINEAR, seen)
    jax.grad(lambda p: jnp.sum(find(with_parameters(system, p, system.b), adjoint=spy).value))(
        system.p
    )
    assert seen and all(
        found == (lx.JacobianLinearOperator, 1, system.b.shape) for found in seen
    ), seen


def test_an_ambiguous_or_missing_system_is_refused():
    operator = lx.JacobianLinearOperator(lambda y, args: 2 * y, jnp.ones(3), None)
    with pytest.raises(ValueError, match="`args` is one AbstractSparseSystem"):
        LINEAR.init(operator, {})

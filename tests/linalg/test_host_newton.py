"""solve_on_host against SparseNewton: the same roots, a kept Jacobian, and named failures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from jaxwillmore.linalg import (
    EXACT,
    HostMatrix,
    HostNewton,
    HostSystem,
    SparseNewton,
    SparseSolver,
    solve_on_host,
)

from .systems import FIELDS, Sinh, dense, sinh_system

GROUPS = (((0,),), ((1,),))
TIGHT = HostNewton(1e-12)


@jax.jit
def _residual(system, y):
    return system.residual(y)


@jax.jit
def _jacobian(system, y):
    operator = system.jacobian(y)
    border = operator.border
    return operator.data, (border.columns, border.rows, border.corner)


class OnHost:
    """A traced system in NumPy."""

    n_fields, spans, groups = FIELDS, (slice(0, 1), slice(1, 2)), GROUPS

    def __init__(self, system: Sinh):
        self.system = system
        self.pattern, self.n_globals = system.pattern, system.n_globals
        self.evaluations = {"residual": 0, "jacobian": 0}

    def residual(self, y):
        self.evaluations["residual"] += 1
        return np.asarray(_residual(self.system, jnp.asarray(y)))

    def jacobian(self, y):
        self.evaluations["jacobian"] += 1
        return jax.tree.map(np.asarray, _jacobian(self.system, jnp.asarray(y)))


def on_host(n_globals=0, p=0.5, b=1.0) -> OnHost:
    system = sinh_system(n_globals, p)
    return OnHost(eqx.tree_at(lambda s: s.b, system, b * system.b))


def solve(system, y0=0.0, solver=TIGHT, max_steps=40, **options):
    y0 = np.full(system.system.b.shape, y0)
    return solve_on_host(solver, system, y0, max_steps=max_steps, **options)


def succeeded(solution) -> bool:
    return bool(solution.result == optx.RESULTS.successful)


@pytest.mark.parametrize("n_globals", [0, 1, 2])
def test_the_root_is_that_of_the_traced_iteration(n_globals):
    system = on_host(n_globals)
    assert isinstance(system, HostSystem)
    traced = optx.root_find(
        lambda y, s: s.residual(y),
        SparseNewton(1e-13, SparseSolver(GROUPS, 1e-13)),
        jnp.zeros(system.system.b.shape),
        system.system,
    )
    found = solve(system)
    assert succeeded(found) and isinstance(found.y, np.ndarray)
    np.testing.assert_allclose(found.y, traced.value, atol=1e-11)
    np.testing.assert_array_equal(found.f, system.residual(found.y))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-9])
def test_the_error_is_within_the_tolerance_in_every_field(tolerance):
    """Fields of different size, each against its own largest value."""
    system = on_host(p=1.0, b=np.tile([200.0, 1.0], 12))
    exact = solve(system).y.reshape(-1, FIELDS)
    found = solve(system, solver=HostNewton(tolerance)).y.reshape(-1, FIELDS)
    sizes = np.maximum(np.max(np.abs(exact), axis=0), 1.0)
    assert np.all(np.max(np.abs(found - exact), axis=0) <= tolerance * sizes)


def test_counts_are_those_of_the_system():
    system = on_host(2, p=5.0, b=20.0)
    found = solve(system)
    assert succeeded(found)
    assert found.residuals == system.evaluations["residual"]
    assert found.jacobians == system.evaluations["jacobian"] > 1
    assert found.krylov_iterations >= found.iterations >= found.jacobians
    assert found.residuals >= found.iterations + found.global_corrections


def test_a_known_residual_is_not_evaluated_again():
    system = on_host()
    y0 = np.zeros(system.system.b.shape)
    f0 = system.residual(y0)
    system.evaluations["residual"] = 0
    found = solve_on_host(TIGHT, system, y0, f0)
    assert found.residuals == system.evaluations["residual"] == found.iterations


# The kept Jacobian.


def test_a_nearby_system_is_solved_with_the_kept_jacobian():
    first = solve(on_host(1, p=0.5))
    second = solve(on_host(1, p=0.52), kept=first.kept)
    assert succeeded(second) and second.jacobians == 0 and second.kept is first.kept
    np.testing.assert_allclose(second.y, solve(on_host(1, p=0.52)).y, atol=1e-11)


def test_a_jacobian_that_contracts_too_slowly_is_renewed():
    first = solve(on_host(p=0.5))
    second = solve(on_host(p=50.0, b=20.0), kept=first.kept)
    assert succeeded(second) and second.jacobians > 0
    assert not first.kept.alive and second.kept.alive


def test_a_correction_that_fails_with_a_kept_jacobian_is_tried_with_a_new_one():
    """The sign of the kept matrix is wrong: no correction descends, and all are thrown away."""
    system = on_host()
    data, border = system.jacobian(np.zeros(system.system.b.shape))
    useless = HostMatrix(system.pattern, -data, border, GROUPS)
    found = solve(system, kept=useless)
    assert succeeded(found) and found.jacobians == 1 and not useless.alive
    anew = solve(system)
    assert found.iterations == anew.iterations + 1
    np.testing.assert_array_equal(found.y, anew.y)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_kept_matrix_that_cannot_be_solved_is_replaced(value):
    system = on_host()
    data, border = system.jacobian(np.zeros(system.system.b.shape))
    found = solve(system, kept=HostMatrix(system.pattern, value * data, border, GROUPS))
    assert succeeded(found) and found.jacobians == 1


def test_a_solve_that_fails_with_a_kept_jacobian_begins_again_without_it():
    """Three iterations are not enough for the kept one; with a new one they are."""
    kept = solve(on_host(p=1.0)).kept
    linear = on_host(p=0.0)
    solver = HostNewton(1e-9, forcing=1e-13, mixing=0)
    found = solve(linear, solver=solver, kept=kept, max_steps=3)
    assert succeeded(found) and found.jacobians == 1 and not kept.alive
    assert 3 < found.iterations <= 6  # those of both attempts
    A = dense(linear.system.operator)
    np.testing.assert_allclose(found.y, np.linalg.solve(A, linear.system.b), atol=1e-8)


def test_a_released_or_foreign_matrix_is_ignored():
    kept = solve(on_host()).kept
    kept.release()
    assert solve(on_host(), kept=kept).jacobians > 0
    assert solve(on_host(2), kept=solve(on_host()).kept).jacobians > 0


# Mixing.


def test_mixing_saves_iterations_with_a_kept_jacobian():
    counts = {}
    for depth in (0, 4):
        kept = solve(on_host(p=1.0, b=5.0)).kept
        solver = HostNewton(1e-11, mixing=depth, keep=0.9, forcing=1e-6)
        found = solve(on_host(p=1.6, b=5.0), solver=solver, kept=kept, max_steps=60)
        assert succeeded(found) and found.jacobians == 0
        counts[depth] = found.iterations
    assert counts[4] < 0.75 * counts[0], counts


# Global equations.


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
def test_constraints_hold_to_the_end_whatever_the_tolerance(tolerance):
    system = on_host(2, p=2.0, b=5.0)
    found = solve(system, solver=HostNewton(tolerance))
    assert succeeded(found)
    assert np.max(np.abs(found.f[-2:])) <= EXACT
    # No full iterations went into that: the nodal equations are far from it.
    assert np.max(np.abs(found.f[:-2])) > 1e-3 * tolerance
    assert found.global_corrections > 0


# Difficult starts and failures, each with its name.


def test_the_root_does_not_depend_on_the_start():
    """A start where the full step overshoots by e⁶: damping brings it back."""
    system = on_host(p=2.0)
    far = solve(system, 6.0, max_steps=60)
    assert succeeded(far) and far.residuals > far.iterations
    np.testing.assert_allclose(far.y, solve(system).y, atol=1e-11)


def failure(solution):
    assert solution.kept is None
    return solution.result


def test_too_few_steps():
    assert bool(
        failure(solve(on_host(p=5.0), max_steps=2)) == optx.RESULTS.nonlinear_max_steps_reached
    )


@pytest.mark.parametrize("where", ["start", "everywhere"])
def test_values_that_are_not_finite_are_named(where):
    system = on_host()
    if where == "everywhere":
        system.residual = lambda y: np.full(y.shape, np.nan) if np.any(y) else -np.ones(y.shape)
        expected = optx.RESULTS.nonfinite
    else:
        expected = optx.RESULTS.nonfinite_input
    found = solve(system, np.nan if where == "start" else 0.0)
    assert bool(failure(found) == expected), found.result


def test_a_singular_jacobian():
    system = on_host(p=0.0)
    system.system = eqx.tree_at(
        lambda s: s.operator.data, system.system, jnp.zeros_like(system.system.operator.data)
    )
    assert bool(failure(solve(system)) == optx.RESULTS.singular)


def test_corrections_that_grow():
    """The Jacobian is a fifth of what it should be; small residuals are taken without damping."""
    system = on_host(p=0.0, b=1e-7)
    right = system.jacobian
    system.jacobian = lambda y: jax.tree.map(lambda a: a / 5, right(y))
    solver = HostNewton(1e-12, mixing=0)
    assert bool(failure(solve(system, solver=solver)) == optx.RESULTS.nonlinear_divergence)


def test_a_failure_leaves_the_last_vector_with_its_residual():
    system = on_host(p=5.0, b=20.0)
    found = solve(system, max_steps=2)
    np.testing.assert_array_equal(found.f, system.residual(found.y))

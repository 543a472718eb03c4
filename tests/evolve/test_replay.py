"""Replays: the states of the run, and derivatives by everything that enters it."""

import functools as ft

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.evolve import Stepper, evolve, replay
from jaxwillmore.flows import WillmoreFlow
from jaxwillmore.mesh import ellipsoid

from ..helpers import observed_order

AXES = (1.0, 1.2, 1.5)
MESH, X = ellipsoid(AXES, 0, 2)
# A stepper outside of all traces: its sparsity is computed once.
STEPPER = Stepper(WillmoreFlow(), MESH, newton_tolerance=1e-12)
LOADS = jr.normal(jr.key(0), (2, *X.shape))


def parameters(n_steps):
    """Everything that a run depends on; uneven steps, as an adaptive run has them."""
    steps = 1e-3 * jnp.array([1.0, 1.5, 2.0, 1.2])[jnp.arange(n_steps) % 4]
    return {
        "bending_modulus": jnp.asarray(0.6),
        "spontaneous_curvature": jnp.asarray(0.4),
        "x0": X,
        "times": jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)]),
    }


def final_state(p, *, checkpoint=True, stepper=STEPPER):
    """A number that depends on all nodes and normals at the end."""
    flow = WillmoreFlow(p["bending_modulus"], p["spontaneous_curvature"])
    run = replay(flow, MESH, p["x0"], p["times"], stepper=stepper, checkpoint=checkpoint)
    x, nu = run.x[-1], run.fields["nu"][-1]
    return jnp.vdot(LOADS[0], x + 0.1 * x**2) + jnp.vdot(LOADS[1], nu)


DIRECTIONS = {
    "bending_modulus": lambda p: jnp.asarray(1.0),
    "spontaneous_curvature": lambda p: jnp.asarray(1.0),
    "x0": lambda p: jnp.sin(X + jnp.array([[0.3, 1.1, -0.7]])) * X[:, 1:2],
    # The length of all steps: dτ/τ = 1.
    "times": lambda p: p["times"],
}


def richardson(f, h):
    """The slope at zero with an error of O(h⁴)."""
    central = lambda h: (f(h) - f(-h)) / (2 * h)
    return (4 * central(h / 2) - central(h)) / 3


@pytest.fixture(scope="module", params=[1, pytest.param(20, marks=pytest.mark.slow)])
def compiled(request):
    """Value, gradient and directional derivative, compiled once for all tests."""
    p = parameters(request.param)
    both = jax.jit(jax.value_and_grad(final_state))
    forward = jax.jit(lambda p, d: jax.jvp(final_state, (p,), (d,))[1])
    return p, lambda p: both(p)[0], both(p)[1], forward


def along(p, name, direction):
    return lambda h: p | {name: p[name] + h * direction}


@pytest.mark.parametrize("name", DIRECTIONS)
def test_derivatives_by_every_parameter(compiled, name):
    """Reverse equals forward to 1e-10, and differences to 1e-7."""
    p, value, gradient, forward = compiled
    direction = DIRECTIONS[name](p)
    reverse = float(jnp.vdot(gradient[name], direction))
    tangent = jax.tree.map(jnp.zeros_like, p) | {name: direction}
    assert abs(reverse) > 1e-6  # a test of nothing would pass
    assert float(forward(p, tangent)) == pytest.approx(reverse, rel=1e-10)
    path = along(p, name, direction)
    difference = richardson(lambda h: float(value(path(h))), 4e-3)
    assert difference == pytest.approx(reverse, rel=1e-7)


def test_taylor_remainders_in_all_parameters_at_once(compiled):
    p, value, gradient, _ = compiled
    direction = {name: DIRECTIONS[name](p) for name in DIRECTIONS}
    slope = sum(float(jnp.vdot(gradient[name], direction[name])) for name in direction)
    # Small steps: the third order of a long run is large.
    start, steps = float(value(p)), (2e-3, 1e-3, 5e-4)
    remainders = [
        abs(
            float(value(jax.tree.map(lambda a, d, h=h: a + h * d, p, direction)))
            - start
            - h * slope
        )
        for h in steps
    ]
    assert abs(observed_order(steps, remainders) - 2.0) < 0.15, remainders


# Sixteen membranes at once.
DENSE = Stepper(WillmoreFlow(), MESH, newton_tolerance=1e-12, linear_solver="dense")
MODULI = jnp.linspace(0.3, 0.9, 16)


@pytest.mark.slow
def test_a_batch_is_one_program_and_equals_a_loop():
    """Values and slopes by `"dense"` under `vmap`, against the sparse solver one by one."""
    p = parameters(3)
    of = lambda b, stepper: final_state(p | {"bending_modulus": b}, stepper=stepper)
    alone = jax.jit(jax.vmap(lambda b: of(b, DENSE)))
    assert "callback" not in alone.lower(MODULI).as_text()
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(lambda b: of(b, DENSE))))(MODULI)
    one = jax.jit(jax.value_and_grad(lambda b: of(b, STEPPER)))
    expected = [one(b) for b in MODULI]
    np.testing.assert_allclose(values, [value for value, _ in expected], rtol=1e-9)
    np.testing.assert_allclose(slopes, [slope for _, slope in expected], rtol=1e-8)


@pytest.mark.slow
def test_a_batch_of_the_sparse_solver_equals_a_loop():
    p = parameters(3)
    value_and_slope = jax.value_and_grad(lambda b: final_state(p | {"bending_modulus": b}))
    moduli = MODULI[::5]
    values, slopes = jax.jit(jax.vmap(value_and_slope))(moduli)
    one = jax.jit(value_and_slope)
    for k, b in enumerate(moduli):
        value, slope = one(b)
        np.testing.assert_allclose(values[k], value, rtol=1e-9)
        np.testing.assert_allclose(slopes[k], slope, rtol=1e-8)


@pytest.mark.slow
def test_checkpoints_change_memory_and_not_the_gradient():
    p, n = parameters(6), 6
    plain, kept = (
        jax.jit(jax.grad(ft.partial(final_state, checkpoint=checkpoint))).lower(p).compile()
        for checkpoint in (False, True)
    )
    for a, b in zip(jax.tree.leaves(plain(p)), jax.tree.leaves(kept(p)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-10)
    # Without them every step keeps its matrix: 8 x 8 numbers for every pair of neighbours.
    matrices = 8 * 64 * n * STEPPER.problem.pattern.n_blocks
    saved = plain.memory_analysis().temp_size_in_bytes - kept.memory_analysis().temp_size_in_bytes
    assert saved > 0.5 * matrices


@pytest.mark.slow
@pytest.mark.parametrize("bdf_order", [1, 3, 4])
def test_other_orders_replay_their_runs(bdf_order):
    flow = WillmoreFlow()
    solution = evolve(flow, MESH, X, t1=2e-3, dt0=2e-4, rtol=None, bdf_order=bdf_order)
    run = replay(flow, MESH, X, jnp.asarray(solution.times), bdf_order=bdf_order)
    np.testing.assert_allclose(run.x[-1], solution.state.x, atol=1e-7)


@pytest.mark.slow
def test_the_linear_scheme_has_derivatives_and_the_implicit_limit():
    """As τ → 0 the two schemes and their derivatives meet, with order two for BDF2."""
    flow = WillmoreFlow(0.6, 0.4)

    def last(b, n, scheme):
        times = jnp.linspace(0.0, 4e-3, n + 1)
        moved = eqx.tree_at(lambda flow: flow.bending_modulus, flow, b)
        run = replay(moved, MESH, X, times, scheme=scheme)
        return jnp.vdot(LOADS[0], run.x[-1])

    gaps = []
    for n in (8, 16, 32):
        both = [
            jax.jit(jax.value_and_grad(ft.partial(last, n=n, scheme=scheme)))(jnp.asarray(0.6))
            for scheme in ("implicit", "linearly-implicit")
        ]
        gaps.append([abs(float(a - b)) for a, b in zip(*both, strict=True)])
    values, slopes = np.array(gaps).T
    # Order two is approached from below: 1.45, then 1.67.
    assert observed_order((2, 1), values[1:]) > 1.6, values
    assert slopes[-1] < slopes[0] / 4, slopes


@pytest.mark.slow
def test_a_traced_mesh_needs_a_stepper_and_then_works():
    """Connectivity may be an argument of a compiled function; its sparsity cannot be."""
    run = lambda mesh, x, **kw: replay(WillmoreFlow(), mesh, x, jnp.array([0.0, 1e-3]), **kw)
    traced = eqx.filter_jit(lambda mesh, x: run(mesh, x, stepper=STEPPER).x[-1])
    np.testing.assert_allclose(traced(MESH, X), run(MESH, X).x[-1], atol=1e-9)

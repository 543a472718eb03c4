"""Flow with carried fields in time: it descends its energy, rests where it should, steps right."""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.evolve import evolve, replay
from jaxwillmore.fem import integrate
from jaxwillmore.flows import HelfrichFlow, Loads, System, WillmoreFlow, as_system
from jaxwillmore.mesh import ellipsoid, icosphere
from jaxwillmore.surface import centroid, volume

from .carried_fields import AXES, b, descent, flow_on, on, speed, velocity_of_law

# 1. The law is minus the gradient of the energy.


@pytest.mark.slow
def test_the_energy_falls_at_the_rate_of_the_law():
    """By order in h over two refinements: dE/dt = −∫V² (2.9), dE(φν) = −∫Vφ (4), V itself (1.9)."""
    coarse, fine = (
        descent(flow_on(x), lambda x: on(x, speed), mesh, x)
        for mesh, x in (ellipsoid(AXES, level, 2) for level in (1, 3))
    )
    orders = 0.5 * np.log2(coarse / fine)
    assert np.all(fine < np.array([5e-3, 1e-3, 1e-2])), fine
    assert np.all(orders > np.array([2.0, 3.5, 1.7])), orders


def rest_by_gaussian_modulus(z, b):
    """b_k = −2b: E = ∫(b/2)(κ₁ − κ₂)² for every b, and a sphere has none. No pressure."""
    return HelfrichFlow(b / 2, gaussian_modulus=-2 * b), 0.0


def rest_by_spontaneous_curvature(z, _):
    """b = 1, H₀ = cz, b_k = 2cz − c²z²/6: V = 4cz − c²z² + Δb_k = −c²/3, which P balances."""
    c = 0.8
    return HelfrichFlow(0.5, c * z, 2 * c * z - c**2 * z**2 / 6), c**2 / 3


@pytest.mark.parametrize("balance", [rest_by_gaussian_modulus, rest_by_spontaneous_curvature])
def test_unit_spheres_that_rest_because_of_their_fields(balance):
    """V = 0 to rounding or by order in h, while without b_k it is of order one."""

    @eqx.filter_jit
    def speed_of(flow, mesh, x, P):
        V = velocity_of_law(flow, mesh, x, jnp.full(mesh.n_nodes, 2.0), x)
        return jnp.sqrt(integrate(mesh, x, lambda _, f: (f.V.value + P) ** 2, {"V": V}))

    speeds = []
    for level in (1, 2):
        mesh, x = icosphere(level, 2)
        flow, P = balance(x[:, 2], on(x, b))
        speeds.append(float(speed_of(flow, mesh, x, P)))
    loose = eqx.tree_at(lambda f: f.energy.gaussian_modulus, flow, 0 * x[:, 2])
    moving = float(speed_of(loose, mesh, x, P))
    assert speeds[1] < 0.02 * moving, (speeds, moving)
    assert speeds[1] < 1e-12 or np.log2(speeds[0] / speeds[1]) > 1.5, speeds


# 2. Whole steps, on 42 nodes.


@pytest.fixture(scope="module")
def start():
    """A surface, and the nodes after one step from it."""
    mesh, x = ellipsoid(AXES, 0, 2)

    @eqx.filter_jit
    def step(flow, tau, scheme="implicit"):
        times = jnp.stack([jnp.zeros(()), tau])
        return replay(flow, mesh, x, times, scheme=scheme, newton_tolerance=1e-12).x[-1]

    return x, step


TAU, LINEAR = jnp.asarray(1e-3), "linearly-implicit"


@pytest.mark.slow
def test_constant_fields_step_as_willmore_flow(start):
    x, step = start
    one = jnp.ones(len(x))
    expected = step(WillmoreFlow(0.7, 0.5), TAU)
    found = step(HelfrichFlow(0.7 * one, 0.5 * one), TAU)
    assert float(jnp.max(jnp.abs(expected - x))) > 1e-2
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.slow
def test_the_linearly_implicit_step_differs_by_the_square_of_the_step(start):
    """Both schemes are consistent: what the stages solve is the system, up to O(τ²)."""
    x, step = start
    flow = flow_on(x)

    def gap(tau):
        return float(jnp.max(jnp.abs(step(flow, tau) - step(flow, tau, LINEAR))))

    gaps = [gap(TAU / 16), gap(TAU / 32)]
    assert abs(np.log2(gaps[0] / gaps[1]) - 2.0) < 0.3, gaps


@pytest.mark.slow
def test_gradients_of_a_step_by_nodal_fields(start):
    """Against central differences in one direction of all three fields."""
    x, step = start

    def functional(flow):
        return jnp.sum(jnp.array([[1.0, 2.0, 3.0]]) * step(flow, TAU) ** 2)

    flow = flow_on(x)
    names = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")
    directions = [jr.normal(jr.key(k), (len(x),)) for k in range(3)]
    slopes = eqx.filter_jit(eqx.filter_grad(functional))(flow)
    for name, direction in zip(names, directions, strict=True):

        def moved(h, name=name, direction=direction):
            where = lambda f: getattr(f.energy, name)
            return functional(eqx.tree_at(where, flow, where(flow) + h * direction))

        expected = (moved(1e-4) - moved(-1e-4)) / 2e-4
        found = jnp.vdot(getattr(slopes.energy, name), direction)
        assert abs(expected) > 1e-4, name
        np.testing.assert_allclose(found, expected, rtol=1e-5, err_msg=name)


@pytest.mark.slow
def test_with_the_energy_of_a_difference_of_curvatures_everything_becomes_a_sphere():
    """b_k = −2b makes E = ∫(b/2)(κ₁ − κ₂)² whatever b is (here from 0.3 to 2.1): E → 0."""
    mesh, x = ellipsoid(AXES, 1, 2)
    modulus = 1.2 + 0.6 * jnp.sin(1.5 * x[:, 0] + 0.5 * x[:, 1]) + 0.3 * x[:, 2]
    flow = HelfrichFlow(modulus / 2, gaussian_modulus=-2 * modulus)
    run = evolve(System(flow, Loads(volume=volume(mesh, x))), mesh, x, t1=0.4)
    first = as_system(flow).energy(mesh, x)
    energies = np.array([first, *(record["energy"] for record in run.records)])
    # The rest is the error of the mesh: the energy of an interpolated sphere is not zero.
    assert energies[0] > 2.0 and energies[-1] < 0.011, energies
    radii = jnp.linalg.norm(run.state.x - centroid(mesh, run.state.x)[None], axis=1)
    assert float(jnp.ptp(radii) / jnp.mean(radii)) < 0.01
    assert run.stats["rejected_steps"] <= 5, run.stats

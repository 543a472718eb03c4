"""The velocity of minimal deformation: same shape, better triangles."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.flows import MinimalDeformation, System, WillmoreFlow


def edge_ratio(mesh, x):
    return jw.mesh.quality(mesh, x).edge_ratio


@pytest.fixture(scope="module")
def one_step():
    mesh, x = jw.mesh.ellipsoid(semi_axes=(1.0, 1.2, 1.5), level=1, degree=2)
    times = jnp.array([0.0, 1e-3])
    plain = jw.evolve.replay(WillmoreFlow(), mesh, x, times)
    moved = jw.evolve.replay(System(WillmoreFlow(), MinimalDeformation()), mesh, x, times)
    return mesh, x, plain, moved


def velocity(run):
    """(x − x₀)/τ of a step of the implicit Euler method."""
    return (run.x[-1] - run.x[0]) / (run.times[-1] - run.times[0])


def test_normal_component_is_that_of_the_flow(one_step):
    r"""$v = V\nu + w$ with $(w\cdot\nu, \xi) = 0$ for all test functions."""
    mesh, _, _, moved = one_step
    w, nu, V = (moved.fields[name][-1] for name in ("w", "nu", "V"))
    np.testing.assert_allclose(velocity(moved), V[:, None] * nu + w, atol=1e-7)
    assert float(jnp.max(jnp.abs(w))) > 0.01 * float(jnp.max(jnp.abs(V)))
    fields = {"w": w, "nu": nu}

    def density(_, f, phi, __):
        return phi * jnp.sum(f.w.value * f.nu.value)

    defect = jw.fem.load(mesh, moved.x[-1], density, fields)
    assert float(jnp.max(jnp.abs(defect))) < 1e-8 * float(jnp.max(jnp.abs(V)))


def test_velocity_deforms_less_than_the_normal_one(one_step):
    mesh, _, plain, moved = one_step

    def rate(run, v):
        return jw.fem.integrate(mesh, run.x[-1], lambda _, f: jnp.sum(f.v.grad**2), {"v": v})

    assert float(rate(moved, velocity(moved))) < 0.9 * float(rate(plain, velocity(plain)))


def test_velocity_is_the_minimiser(one_step):
    r"""$\int\nabla v:\nabla\eta = 0$ for tangential η up to the error of the mesh."""
    mesh, _, _, moved = one_step
    x, v, nu = moved.x[-1], velocity(moved), moved.fields["nu"][-1]
    nu = nu / jnp.linalg.norm(nu, axis=1, keepdims=True)
    eta = jnp.sin(3 * x[:, jnp.array([1, 2, 0])])
    eta = eta - jnp.sum(eta * nu, axis=1, keepdims=True) * nu

    def pairing(a, b):
        density = lambda _, f: jnp.sum(f.a.grad * f.b.grad)
        return float(jw.fem.integrate(mesh, x, density, {"a": a, "b": b}))

    cosine = pairing(v, eta) / np.sqrt(pairing(v, v) * pairing(eta, eta))
    assert abs(cosine) < 5e-3, cosine


@pytest.mark.slow
def test_red_cell_ends_as_a_sphere_with_even_triangles():
    mesh, x = jw.mesh.red_cell(level=1, degree=2)
    run = jw.evolve.evolve(System(WillmoreFlow(), MinimalDeformation()), mesh, x, t1=5.0)
    last = run.records[-1]
    assert abs(last["willmore"] / (8 * np.pi) - 1) < 1e-4
    assert edge_ratio(mesh, run.state.x) < 1.4
    assert run.stats["rejected_steps"] <= 3
    settled = [r["area"] for r in run.records if r["t"] > 0.8]
    assert np.ptp(settled) < 1e-3 * settled[-1]

"""Willmore energy: known values, invariances, the first variation against its formula."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import Willmore, willmore_of_field
from jaxwillmore.fem import integrate
from jaxwillmore.mesh import dumbbell, ellipsoid, icosphere, red_cell, torus
from jaxwillmore.surface import Ellipsoid, area

from ..helpers import observed_order, random_rotation, taylor_remainders

willmore = eqx.filter_jit(Willmore())


# 1. Closed forms and computed constants. Degree 2, order 4: 4e-4 to 1e-4 at these levels.
@pytest.mark.parametrize(
    "shape, expected, rtol",
    [
        (lambda: icosphere(2, 2), 8 * np.pi, 2e-4),
        (lambda: torus(1.0, 2**-0.5, level=2, degree=2), 4 * np.pi**2, 2e-4),
        (lambda: torus(1.0, 0.4, level=2, degree=2), 53.84310625, 2e-4),
        (lambda: ellipsoid((1.0, 1.0, 2.0), 2, 2), 30.90321329, 2e-4),
        (lambda: ellipsoid((1.0, 1.0, 0.5), 2, 2), 33.80462393, 2e-4),
        (lambda: red_cell(2, 2), 46.148735, 4e-4),
        (lambda: dumbbell(2, 2), 38.30406844, 8e-4),
    ],
    ids=["sphere", "Clifford", "torus", "prolate", "oblate", "red cell", "dumbbell"],
)
def test_known_energies(shape, expected, rtol):
    np.testing.assert_allclose(willmore(*shape()), expected, rtol=rtol)


@pytest.mark.slow
def test_sphere_converges_with_order_four():
    errors = [abs(willmore(*icosphere(level, 2)) - 8 * np.pi) for level in (2, 3, 4)]
    order = observed_order((1.0, 0.5, 0.25), errors)
    assert abs(order - 4.0) < 0.15, (order, errors)


# 2. Symmetries, to the tolerance of the projection.
def test_willmore_energy_ignores_motion_and_scale():
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]]) + 0.02 * jr.normal(jr.key(0), x.shape)
    here = willmore(mesh, x)
    R = random_rotation(jr.key(1))
    for y in (x @ R.T + jnp.array([[1.0, -2.0, 0.5]]), 1e-6 * x, 1e6 * x):
        np.testing.assert_allclose(willmore(mesh, y), here, rtol=1e-11)
    # The bound 8π holds for smooth surfaces, and here with room for the error of the mesh.
    assert here > 8 * np.pi


def test_vmap_equals_a_loop():
    mesh, x = icosphere(1, 2)
    xs = jnp.stack([x, x * jnp.array([[1.0, 1.0, 2.0]])])
    batched = jax.jit(jax.vmap(lambda x: Willmore()(mesh, x)))(xs)
    np.testing.assert_allclose(batched, [willmore(mesh, y) for y in xs], rtol=1e-11)


# 3. The derivative.
def test_willmore_gradient():
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]])
    f = jax.jit(lambda x: Willmore()(mesh, x))
    phi, steps = jr.normal(jr.key(2), x.shape), (1e-3, 5e-4, 2.5e-4)
    order = observed_order(steps, taylor_remainders(f, x, phi, steps))
    assert abs(order - 2.0) < 0.1, order
    _, forward = jax.jvp(f, (x,), (phi,))
    np.testing.assert_allclose(forward, jnp.vdot(jax.grad(f)(x), phi), rtol=1e-10)


# 4. The theory behind the derivative.
def laplace_beltrami_of_curvature(surface, x):
    """Δ_Γ H as the tangential divergence of the tangential gradient of H."""

    def at(p):
        nu = surface.normal(p[None])[0]
        D = jax.jacfwd(lambda q: surface.mean_curvature_gradient(q[None])[0])(p)
        return jnp.trace(D) - nu @ D @ nu

    return jax.vmap(at)(x)


def test_first_variation_is_the_willmore_equation():
    """dE(Vν) = ∫ (−ΔH + ½H³ − H|A|²) V, with exact curvatures of a triaxial ellipsoid."""
    axes = (1.0, 1.2, 1.5)
    mesh, x = ellipsoid(axes, 3, 2)
    surface = Ellipsoid(axes)

    @jax.jit
    def both(x):
        H, A = surface.mean_curvature(x), surface.weingarten(x)
        laplacian = laplace_beltrami_of_curvature(surface, x)
        gradient = -laplacian + 0.5 * H**3 - H * jnp.sum(A * A, axis=(1, 2))
        V = 1.0 + 0.5 * x[:, 0] - 0.3 * x[:, 1] * x[:, 2] + x[:, 2] ** 2
        expected = integrate(mesh, x, lambda _, f: f.g.value * f.V.value, {"g": gradient, "V": V})
        phi = V[:, None] * surface.normal(x)
        _, slope = jax.jvp(lambda x: Willmore()(mesh, x), (x,), (phi,))
        return slope, expected

    slope, expected = both(x)
    # Order 4 for a normal variation: 1.7e-3 one level below, 1.1e-4 here.
    np.testing.assert_allclose(slope, expected, rtol=2e-4)


def test_spheres_are_critical():
    """Against ∫½H³V = 4∫V of the terms that cancel; the rest is the error of the mesh."""
    mesh, x = icosphere(2, 2)
    phi = x * (1 + x[:, :1] + x[:, 1:2] * x[:, 2:])
    slope = jax.jit(lambda x, phi: jax.jvp(lambda x: Willmore()(mesh, x), (x,), (phi,))[1])(x, phi)
    assert abs(slope) < 1e-3 * 4 * (4 * np.pi)


def test_field_energy_of_a_constant_curvature():
    mesh, x = icosphere(1, 2)
    H = jnp.full(mesh.n_nodes, 2.0)
    whole = area(mesh, x)
    np.testing.assert_allclose(willmore_of_field(mesh, x, H), 2 * whole, rtol=1e-13)

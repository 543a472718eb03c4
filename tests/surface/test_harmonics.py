"""Spherical harmonics: orthonormal, eigenfunctions; coefficients of known star-shaped surfaces."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.mesh import ellipsoid, from_sphere_map, icosphere, refine, torus
from jaxwillmore.surface import harmonic_coefficients, harmonic_power, real_harmonics
from jaxwillmore.verify import rough_sphere

from ..helpers import observed_order, random_rotation, taylor_remainders

L = 3
C = jnp.concatenate([jnp.array([np.sqrt(4 * np.pi)]), 0.06 * jr.normal(jr.key(0), (15,))])
ORIGIN = jnp.zeros(3)


def radius(n):
    return jnp.dot(C, real_harmonics(L, n))


@eqx.filter_jit
def coefficients(mesh, x, centre=None):
    return harmonic_coefficients(mesh, x, L, centre=centre)


def test_harmonics_are_orthonormal_and_have_their_signs():
    """By Gauss's rule in the height and equal angles, exact for products up to degree 12."""
    z, w = np.polynomial.legendre.leggauss(8)
    phi = 2 * np.pi * np.arange(16) / 16
    z, phi, w = (a.ravel() for a in np.broadcast_arrays(z[:, None], phi[None], w[:, None]))
    rho = np.sqrt(1 - z**2)
    n = jnp.asarray(np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1))
    Y = jax.vmap(lambda n: real_harmonics(6, n))(n)
    gram = jnp.einsum("p,pi,pj->ij", jnp.asarray(w * 2 * np.pi / 16), Y, Y)
    np.testing.assert_allclose(gram, np.eye(49), atol=1e-13)
    first = np.sqrt(3 / (4 * np.pi))
    np.testing.assert_allclose(Y[:, 1:4], first * n[:, jnp.array([1, 2, 0])], atol=1e-14)
    expected = np.sqrt(15 / (4 * np.pi)) * n[:, 0] * n[:, 1]
    np.testing.assert_allclose(Y[:, 4], expected, atol=1e-14)  # l = 2, m = −2


def test_harmonics_are_harmonic_polynomials():
    """|p|^l Y_lm(p/|p|) has no Laplacian."""
    p = jnp.array([0.3, -0.7, 0.5])

    def solid(p):
        r = jnp.sqrt(jnp.sum(p * p))
        powers = [r**k for k in range(5) for _ in range(2 * k + 1)]
        return real_harmonics(4, p / r) * jnp.stack(powers)

    laplacian = jnp.trace(jax.jacfwd(jax.jacfwd(solid))(p), axis1=1, axis2=2)
    np.testing.assert_allclose(laplacian, 0.0, atol=1e-12)


def test_coefficients_of_a_known_surface_come_back_with_order_four():
    meshes = [from_sphere_map(lambda n: radius(n) * n, level, 2) for level in (1, 2)]
    errors = [float(jnp.max(jnp.abs(coefficients(*m, ORIGIN) - C))) for m in meshes]
    assert observed_order((2.0, 1.0), errors) > 3.7, errors
    assert errors[1] < 1e-3  # of √4π; measured 4e-4


def test_nodes_do_not_matter_but_for_the_error_of_the_mesh():
    mesh, n = rough_sphere(2, 2)
    rough = coefficients(mesh, n * jax.vmap(radius)(n)[:, None], ORIGIN)
    np.testing.assert_allclose(rough, C, atol=2e-3)


def test_high_degrees_are_integrated_on_large_cells():
    """Cells of the same surface cut into quarters: only the quadrature differs."""
    mesh, x = ellipsoid((0.8, 0.8, 1.6), level=1, degree=2)
    whole = harmonic_coefficients(mesh, x, 12, centre=ORIGIN)
    cut = harmonic_coefficients(*refine(mesh, x), 12, centre=ORIGIN)
    np.testing.assert_allclose(whole, cut, atol=1e-3)  # 3e-2 without quarters


def test_power_is_invariant_under_rotation_and_shift():
    """About the centre of the body, which moves along."""
    mesh, x = from_sphere_map(lambda n: radius(n) * n, 1, 2)
    R = random_rotation(jr.key(1))
    here, moved = (
        harmonic_power(coefficients(mesh, y)) for y in (x, x @ R.T + jnp.array([[1.0, -2.0, 0.5]]))
    )
    # The quadrature does not turn with the surface: its error is 1e-6 here.
    np.testing.assert_allclose(moved, here, atol=1e-5)
    assert moved.shape == (L + 1,)


@pytest.mark.slow
def test_derivatives():
    mesh, x = from_sphere_map(lambda n: radius(n) * n, 0, 2)
    phi, w = jr.normal(jr.key(2), x.shape), jr.normal(jr.key(3), C.shape)
    f = jax.jit(lambda x: jnp.vdot(w, harmonic_coefficients(mesh, x, L)))
    _, forward = jax.jvp(f, (x,), (phi,))
    np.testing.assert_allclose(forward, jnp.vdot(jax.grad(f)(x), phi), rtol=1e-11)
    steps = (1e-3, 5e-4, 2.5e-4)
    remainders = taylor_remainders(f, x, phi, steps)
    assert abs(observed_order(steps, remainders) - 2.0) < 0.05, remainders


def test_growing_a_sphere_grows_the_first_coefficient():
    """dc_00 = √4π dR, exactly up to the mesh; no other coefficient changes."""
    mesh, x = icosphere(1, 2)
    _, slope = jax.jvp(lambda x: coefficients(mesh, x, ORIGIN), (x,), (x,))
    expected = jnp.zeros(16).at[0].set(np.sqrt(4 * np.pi))
    np.testing.assert_allclose(slope, expected, atol=4e-3)


def test_a_torus_is_refused():
    mesh, x = torus(level=1)
    with pytest.raises(Exception, match="not star-shaped"):
        harmonic_coefficients(mesh, x, 1)
    with pytest.raises(ValueError, match="negative"):
        real_harmonics(-1, x[0])

"""Rays and profiles: closed forms, other meshes, derivatives, rays that miss."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.mesh import ellipsoid, icosphere, red_cell
from jaxwillmore.surface import angle_profile, height_profile, ray_lengths
from jaxwillmore.verify import rough_sphere

from ..helpers import observed_order, random_rotation, taylor_remainders

AXES = np.array([1.0, 1.2, 1.5])
DIRECTIONS = jr.normal(jr.key(0), (40, 3))
ORIGINS = jnp.zeros((40, 3))

rays = eqx.filter_jit(ray_lengths)


def exact_lengths():
    d = np.asarray(DIRECTIONS)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return 1 / np.sqrt(np.sum((d / AXES) ** 2, axis=1))


def test_rays_in_an_ellipsoid_have_their_lengths_with_order_four():
    errors = [
        np.max(np.abs(rays(*ellipsoid(tuple(AXES), n, 2), ORIGINS, DIRECTIONS) - exact_lengths()))
        for n in (1, 2)
    ]
    assert observed_order((2.0, 1.0), errors) > 3.5, errors
    assert errors[1] < 2e-4


def test_rays_do_not_see_the_nodes():
    mesh, n = rough_sphere(2, 2)
    found = rays(mesh, n * jnp.asarray(AXES)[None], ORIGINS, DIRECTIONS)
    np.testing.assert_allclose(found, exact_lengths(), atol=2e-3)


def test_rays_end_on_the_first_sheet():
    """From the middle of a red cell along a chord: up to the surface, not through it."""
    mesh, x = red_cell(1, 2)
    # Half the thickness at the centre is thickness (1 − dimple) = 0.3.
    up = ray_lengths(mesh, x, jnp.zeros((1, 3)), jnp.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(up, 0.3, atol=5e-3)


@pytest.mark.slow
def test_profiles_of_an_ellipsoid_of_revolution():
    """r(z) = a √(1 − z²/c²) and an ellipse in the meridian; both follow the body around."""
    mesh, x = ellipsoid((1.0, 1.0, 1.5), 2, 2)
    heights, angles = jnp.linspace(-1.2, 1.2, 7), jnp.linspace(0.1, 6.0, 7)
    exact_radius = np.sqrt(1 - (np.asarray(heights) / 1.5) ** 2)
    exact_distance = 1 / np.sqrt(np.cos(angles) ** 2 + (np.sin(angles) / 1.5) ** 2)
    np.testing.assert_allclose(height_profile(mesh, x, heights), exact_radius, atol=3e-4)
    across = (0.0, -1.0, 0.0)  # the plane of x and z
    found = angle_profile(mesh, x, angles, axis=across)
    np.testing.assert_allclose(found, exact_distance, atol=3e-4)
    R = random_rotation(jr.key(1))
    turned = angle_profile(
        mesh,
        x @ R.T + 3.0,
        angles,
        axis=tuple(map(float, R @ jnp.array(across))),
        towards=tuple(map(float, R[:, 0])),
    )
    np.testing.assert_allclose(turned, found, atol=1e-12)


@pytest.mark.slow
def test_derivatives():
    mesh, x = ellipsoid(tuple(AXES), 0, 2)
    w, phi = jr.normal(jr.key(2), (6,)), jr.normal(jr.key(3), x.shape)
    heights, angles = jnp.array([-0.5, 0.1, 0.7]), jnp.array([0.2, 1.7, 4.0])

    @jax.jit
    def f(x):
        # Turned out of the mirror planes of the mesh: an edge has two derivatives.
        a = height_profile(mesh, x, heights, towards=(1.0, 0.3, 0.1), n_rays=3)
        b = angle_profile(mesh, x, angles, axis=(0.1, 0.2, 1.0))
        return jnp.vdot(w, jnp.concatenate([a, b]))

    _, forward = jax.jvp(f, (x,), (phi,))
    np.testing.assert_allclose(forward, jnp.vdot(jax.grad(f)(x), phi), rtol=1e-11)
    steps = (4e-4, 2e-4, 1e-4)
    remainders = taylor_remainders(f, x, phi, steps)
    assert abs(observed_order(steps, remainders) - 2.0) < 0.05, remainders
    slope = lambda x: jax.jvp(f, (x,), (phi,))[1]
    second = jax.jvp(slope, (x,), (phi,))[1]
    difference = (slope(x + 1e-6 * phi) - slope(x - 1e-6 * phi)) / 2e-6
    np.testing.assert_allclose(second, difference, rtol=1e-5)


def test_the_derivative_along_the_normal_is_one_over_the_cosine():
    """Growing a sphere makes every ray from its centre longer by as much."""
    mesh, x = icosphere(1, 2)
    _, slope = jax.jvp(lambda x: rays(mesh, x, ORIGINS, DIRECTIONS), (x,), (x,))
    np.testing.assert_allclose(slope, 1.0, atol=5e-3)


def test_rays_that_miss_are_refused():
    mesh, x = icosphere(0, 2)
    with pytest.raises(Exception, match="does not meet the surface"):
        ray_lengths(mesh, x, jnp.full((1, 3), 3.0), jnp.ones((1, 3)))
    with pytest.raises(ValueError, match="at least 1"):
        height_profile(mesh, x, jnp.zeros(1), n_rays=0)

"""Signed distances: exact values, order, derivatives by the envelope theorem."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.fit import Surface, closest, signed_distance

from ..helpers import observed_order, random_rotation

POINTS = jr.normal(jr.key(0), (60, 3))


def test_distance_to_a_sphere_converges():
    """The surface is within O(h⁴) of the sphere for degree 2 (in the mean of its sign)."""
    errors = []
    for level in (0, 1, 2):
        mesh, x = meshes.icosphere(level, degree=2)
        d = signed_distance(Surface(mesh.cells, x), POINTS)
        errors.append(float(jnp.max(jnp.abs(d - (jnp.linalg.norm(POINTS, axis=1) - 1)))))
    assert observed_order((4.0, 2.0, 1.0), errors) > 2.8, errors


def test_distance_to_flat_triangles_is_exact():
    """A cube's distance is known: the norm of what sticks out, or the depth below a face."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    cells = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    points = np.asarray(POINTS) * 0.8 + 0.5
    out = np.maximum(np.maximum(-points, points - 1), 0)
    inside = np.all(out == 0, axis=1)
    exact = np.where(
        inside, np.min(np.minimum(points, 1 - points), axis=1), np.linalg.norm(out, axis=1)
    )
    cell, basis = closest(cells, corners, points)
    at = np.einsum("pj,pjd->pd", basis[..., 0], corners[cells[cell]])
    np.testing.assert_allclose(np.linalg.norm(points - at, axis=1), exact, atol=1e-12)


@pytest.fixture(scope="module")
def pair():
    mesh, x = meshes.ellipsoid((1.0, 1.2, 1.6), 1, 2)
    direction = jnp.sin(2 * x + jnp.array([[0.1, 0.5, 1.1]]))
    return mesh, x, direction


def test_derivatives_by_nodes_and_points_are_exact(pair):
    """Although the closest points move, the distance does not feel it to first order."""
    mesh, x, direction = pair
    of = jax.jit(lambda x, p: signed_distance(Surface(mesh.cells, x), p))
    tangents = (direction, jnp.cos(3 * POINTS))
    _, slope = jax.jvp(of, (x, POINTS), tangents)
    h = 1e-5
    ends = [of(x + s * h * tangents[0], POINTS + s * h * tangents[1]) for s in (1, -1)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), atol=1e-7)
    weights = jnp.arange(60.0)
    _, pull = jax.vjp(of, x, POINTS)
    gradients = pull(weights)
    reverse = sum(jnp.vdot(g, t) for g, t in zip(gradients, tangents, strict=True))
    np.testing.assert_allclose(reverse, jnp.vdot(weights, slope), rtol=1e-12)


def test_distance_ignores_rigid_motion(pair):
    mesh, x, _ = pair
    R, b = random_rotation(jr.key(2)), jnp.array([[1.0, -2.0, 0.5]])
    here = signed_distance(Surface(mesh.cells, x), POINTS)
    there = signed_distance(Surface(mesh.cells, x @ R.T + b), POINTS @ R.T + b)
    np.testing.assert_allclose(here, there, atol=1e-9)


def test_a_surface_that_is_not_finite_has_no_distance(pair):
    mesh, x, _ = pair
    assert np.all(np.isnan(signed_distance(Surface(mesh.cells, jnp.nan * x), POINTS)))

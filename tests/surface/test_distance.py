"""Signed distance: exact parallel surfaces, brute force on the discrete one, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxwillmore.mesh import _closest, ellipsoid, from_torus_map, icosphere
from jaxwillmore.reference import lagrange_basis
from jaxwillmore.surface import Ellipsoid, closest, signed_distance
from jaxwillmore.surface._distance import distance_and_value
from jaxwillmore.verify import rough_sphere

from ..helpers import observed_order, random_rotation, taylor_remainders, with_nan

AXES = (1.0, 1.2, 1.5)
# Points at known distances: on the normals of the exact surface, closer than its focal points.
_N = jr.normal(jr.key(0), (40, 3))
FEET = jnp.asarray(AXES)[None] * _N / jnp.linalg.norm(_N, axis=1, keepdims=True)
HEIGHTS = jnp.linspace(-0.4, 0.6, 40)
POINTS = FEET + HEIGHTS[:, None] * Ellipsoid(AXES).normal(FEET)

ANYWHERE = jr.normal(jr.key(0), (60, 3))

distances = eqx.filter_jit(signed_distance)


@pytest.mark.slow
def test_points_on_normals_have_their_height_with_order_four():
    errors = [
        float(jnp.max(jnp.abs(distances(*ellipsoid(AXES, level, 2), POINTS) - HEIGHTS)))
        for level in (1, 2)
    ]
    assert observed_order((2.0, 1.0), errors) > 3.3, errors
    assert errors[1] < 1e-3


def test_distance_to_a_sphere_converges():
    """The surface is within O(h⁴) of the sphere for degree 2 (in the mean of its sign)."""
    errors = []
    for level in (0, 1, 2):
        d = distances(*icosphere(level, degree=2), ANYWHERE)
        errors.append(float(jnp.max(jnp.abs(d - (jnp.linalg.norm(ANYWHERE, axis=1) - 1)))))
    assert observed_order((4.0, 2.0, 1.0), errors) > 2.8, errors


def test_distance_to_flat_triangles_is_exact():
    """A cube's distance is known: the norm of what sticks out, or the depth below a face."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    cells = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    points = np.asarray(ANYWHERE) * 0.8 + 0.5
    out = np.maximum(np.maximum(-points, points - 1), 0)
    inside = np.all(out == 0, axis=1)
    exact = np.where(
        inside, np.min(np.minimum(points, 1 - points), axis=1), np.linalg.norm(out, axis=1)
    )
    cell, basis = closest(cells, corners, points)
    at = np.einsum("pj,pjd->pd", basis[..., 0], corners[cells[cell]])
    np.testing.assert_allclose(np.linalg.norm(points - at, axis=1), exact, atol=1e-12)


@with_nan
def test_a_surface_that_is_not_finite_has_no_distance():
    mesh, x = icosphere(0, degree=2)
    assert np.all(np.isnan(distances(mesh, jnp.nan * x, ANYWHERE)))


@pytest.mark.parametrize("degree", [1, 2])
def test_no_point_of_the_discrete_surface_is_closer(degree):
    """Against a dense sample of the surface, for points all over the place."""
    mesh, x = ellipsoid(AXES, 1, degree)
    points = jnp.asarray(np.random.default_rng(1).uniform(-2, 2, (40, 3)))
    xi = np.random.default_rng(2).uniform(size=(3000, 2))
    xi = np.where(xi.sum(axis=1, keepdims=True) > 1, 1 - xi, xi)
    cells = np.asarray(x)[np.asarray(mesh.cells)]
    sample = np.einsum("ql,tld->tqd", lagrange_basis(degree, xi), cells).reshape(-1, 3)
    nearest, _ = KDTree(sample).query(np.asarray(points))
    found = distances(mesh, x, points)
    # The sample can only be farther away, by the square of its spacing.
    assert np.all(np.abs(found) <= nearest + 1e-12)
    np.testing.assert_allclose(np.abs(found), nearest, atol=5e-3)
    outside = np.sum((np.asarray(points) / np.array(AXES)) ** 2, axis=1) > 1
    clear = nearest > 0.1
    assert np.all(np.sign(found)[clear] == np.where(outside, 1, -1)[clear])


@pytest.mark.parametrize("degree", [1, 2])
def test_needles_hide_nothing(degree, monkeypatch):
    """Triangles 200 times longer than wide, along a torus; against a dense sample of them."""

    def ring(theta, phi):
        rho = 1 + 0.3 * jnp.cos(phi)
        return jnp.stack([rho * jnp.cos(theta), rho * jnp.sin(theta), 0.3 * jnp.sin(phi)])

    mesh, x = from_torus_map(ring, 12, 600 if degree == 1 else 300, degree)
    cells, nodes = np.asarray(mesh.cells), np.asarray(x)
    # A slice of it: cells need not make up a mesh.
    cells = cells[np.all(nodes[cells][:, :3, 1] > 0.9, axis=1)]
    edges = np.linalg.norm(nodes[cells[:, 0]] - nodes[cells[:, 1:3].T], axis=-1)
    assert np.max(edges.max(axis=0) / edges.min(axis=0)) > 75 * (3 - degree)
    around = np.random.default_rng(4).uniform(-1, 1, (60, 3))
    points = nodes[np.random.default_rng(5).choice(cells[:, 0], 60)] + 0.1 * around
    # In several turns.
    monkeypatch.setattr(_closest, "MOST_PAIRS", 20_000)
    cell, basis = closest(cells, nodes, points)
    found = np.linalg.norm(
        points - np.einsum("pj,pjd->pd", basis[..., 0], nodes[cells[cell]]), axis=1
    )
    xi = np.random.default_rng(6).dirichlet(np.ones(3), 300)[:, :2]
    sample = np.einsum("ql,tld->tqd", lagrange_basis(degree, xi), nodes[cells]).reshape(-1, 3)
    assert np.all(found <= KDTree(sample).query(points)[0] + 1e-12)


def test_nodes_have_no_distance_and_other_meshes_give_the_same():
    mesh, x = ellipsoid(AXES, 1, 2)
    np.testing.assert_allclose(distances(mesh, x, x[:40]), 0.0, atol=1e-14)
    mesh, n = rough_sphere(1, 2)
    other = distances(mesh, n * jnp.asarray(AXES)[None], POINTS)
    np.testing.assert_allclose(other, HEIGHTS, atol=2e-2)


def test_distance_moves_with_the_surface():
    mesh, x = ellipsoid(AXES, 1, 2)
    R, b = random_rotation(jr.key(1)), jnp.array([[1.0, -2.0, 0.5]])
    here = distances(mesh, x, POINTS)
    np.testing.assert_allclose(distances(mesh, x @ R.T + b, POINTS @ R.T + b), here, atol=1e-12)
    np.testing.assert_allclose(distances(mesh, 2 * x, 2 * POINTS), 2 * here, rtol=1e-12)


@pytest.fixture(scope="module")
def weighted():
    """A weighted sum of distances from a small mesh, with points far, near and inside."""
    mesh, x = ellipsoid(AXES, 0, 2)
    w = jr.normal(jr.key(3), (40,))
    return x, POINTS, jax.jit(lambda x, p: jnp.vdot(w, signed_distance(mesh, x, p)))


def test_envelope_theorem():
    """Scaling about the origin: d dist = −n·x(foot), on a sphere −1 for every point."""
    mesh, x = icosphere(1, 2)
    points = 1.5 * x[:40] + 0.02
    _, slope = jax.jvp(lambda x: distances(mesh, x, points), (x,), (x,))
    np.testing.assert_allclose(slope, -1.0, atol=5e-3)


@pytest.mark.slow
def test_first_derivatives(weighted):
    x, p, f = weighted
    phi, psi = jr.normal(jr.key(4), x.shape), jr.normal(jr.key(5), p.shape)
    _, forward = jax.jvp(f, (x, p), (phi, psi))
    gx, gp = jax.grad(f, argnums=(0, 1))(x, p)
    np.testing.assert_allclose(forward, jnp.vdot(gx, phi) + jnp.vdot(gp, psi), rtol=1e-11)
    # Short steps: no foot may cross an edge, where the distance has a kink.
    steps = (4e-5, 2e-5, 1e-5)
    remainders = taylor_remainders(lambda x: f(x, p), x, phi, steps)
    assert abs(observed_order(steps, remainders) - 2.0) < 0.05, remainders


@pytest.mark.slow
def test_second_derivatives(weighted):
    x, p, f = weighted
    phi = jr.normal(jr.key(4), x.shape)
    slope = lambda x: jax.jvp(lambda x: f(x, p), (x,), (phi,))[1]
    _, second = jax.jvp(slope, (x,), (phi,))
    h = 1e-6
    difference = (slope(x + h * phi) - slope(x - h * phi)) / (2 * h)
    np.testing.assert_allclose(second, difference, rtol=1e-5)


def test_at_an_edge_the_foot_slides_along_it():
    """Outside of a polyhedron the foot may be on an edge or a corner; derivatives hold there."""
    mesh, x = icosphere(0, 1)
    corner, middle = 1.4 * x[0], x[mesh.cells[0, 0]] + x[mesh.cells[0, 1]]
    p = jnp.stack([corner, 0.9 * middle + 0.01])
    found = distances(mesh, x, p)
    np.testing.assert_allclose(found[0], 0.4, rtol=1e-13)
    phi = jr.normal(jr.key(6), x.shape)
    steps = (2e-3, 1e-3, 5e-4)
    for k in range(2):
        remainders = taylor_remainders(lambda x, k=k: distances(mesh, x, p)[k], x, phi, steps)
        assert abs(observed_order(steps, remainders) - 2.0) < 0.05, (k, remainders)


# A nodal field at the closest points.
def test_a_field_at_the_closest_points_has_derivatives_by_surface_field_and_point():
    """Central differences; the foot moves along the surface, which is a term of its own."""
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.1, 1.3]])
    points = jnp.mean(x[mesh.cells[::9]], axis=1) * 1.1
    field, key = jnp.sin(x[:, 0] + 2 * x[:, 2]), jr.key(0)
    keys = jr.split(key, 3)
    args = x, field, points
    change = [jr.normal(k, a.shape) for k, a in zip(keys, args, strict=True)]
    weights = jnp.cos(jnp.arange(float(len(points))))

    @jax.jit
    def f(x, field, points):
        return jnp.vdot(weights, distance_and_value(mesh.cells, x, field, points)[1])

    step = 1e-5
    sides = [f(*(a + h * d for a, d in zip(args, change, strict=True))) for h in (-step, step)]
    _, slope = jax.jvp(f, args, tuple(change))
    np.testing.assert_allclose((sides[1] - sides[0]) / (2 * step), slope, rtol=1e-7)
    gradient = jax.grad(f, (0, 1, 2))(*args)
    reverse = sum(jnp.vdot(g, d) for g, d in zip(gradient, change, strict=True))
    np.testing.assert_allclose(reverse, slope, rtol=1e-11)

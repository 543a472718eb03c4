"""New triangles lie on the old surface and have the sizes asked for; fields come along."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.mesh import (
    SurfaceMesh,
    check_mesh,
    ellipsoid,
    icosphere,
    quality,
    red_cell,
    remesh,
    size_by_curvature,
    torus,
)
from jaxwillmore.mesh._adjacency import edges
from jaxwillmore.mesh._triangulation import Triangulation
from jaxwillmore.surface import area, volume

from ..helpers import observed_order


def edge_lengths(mesh, x):
    ends = np.asarray(x)[edges(np.asarray(mesh.triangles)).vertices]
    return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)


def dragged(level=2, degree=2, factor=2.2):
    """A biconcave shape whose nodes are drawn to one pole and wound about the axis."""
    mesh, s = icosphere(level, degree)
    s = np.asarray(s / jnp.linalg.norm(s, axis=1, keepdims=True))
    height = (factor**2 * (1 + s[:, 2]) - (1 - s[:, 2])) / (
        factor**2 * (1 + s[:, 2]) + (1 - s[:, 2])
    )
    flat = np.linalg.norm(s[:, :2], axis=1)
    wide = np.sqrt(np.maximum(1 - height**2, 0.0)) / np.where(flat > 0, flat, 1.0)
    s = np.stack([s[:, 0] * wide, s[:, 1] * wide, height], axis=1)
    c, w = np.cos(1.2 * height), np.sin(1.2 * height)
    s = np.stack([c * s[:, 0] - w * s[:, 1], w * s[:, 0] + c * s[:, 1], height], axis=1)
    s[:, 2] *= 0.25 + 0.45 * (s[:, 0] ** 2 + s[:, 1] ** 2)
    return mesh, jnp.asarray(s)


def test_a_distorted_mesh_becomes_even_on_the_same_surface():
    mesh, x = dragged()
    before, new = quality(mesh, x), remesh(mesh, x)
    after = quality(new.mesh, new.x)
    assert before.min_angle < 30 and before.edge_ratio > 5
    assert after.min_angle > 38 and after.edge_ratio < 1.8
    assert new.mesh.degree == 2 and new.mesh.genus == 0 and check_mesh(new.mesh, new.x).ok
    # Every node is on the smooth surface through the old nodes; triangles of degree 2 are near it.
    assert 1e-5 < float(jnp.max(jnp.linalg.norm(new.transfer(x) - new.x, axis=1))) < 0.03
    for measure in (area, volume):
        assert float(measure(new.mesh, new.x) / measure(mesh, x)) == pytest.approx(1, abs=3e-3)


def test_edges_have_the_size_that_is_asked_for():
    mesh, x = ellipsoid((1.0, 1.0, 1.5), 2, 2)
    for size in (0.5, 0.25):
        lengths = edge_lengths(*remesh(mesh, x, size)[:2]) / size
        assert 0.85 < np.mean(lengths) < 1.1 and np.min(lengths) > 0.5 and np.max(lengths) < 1.5


def test_sizes_follow_the_curvature_and_grow_slowly():
    mesh, x = ellipsoid((1.0, 1.0, 4.0), 3, 2)
    sizes = size_by_curvature(mesh, x, 0.4)
    vertices = np.asarray(x)[: mesh.n_vertices]
    tip, belt = np.argmax(vertices[:, 2]), np.argmin(np.abs(vertices[:, 2]))
    # Curvatures are 4 at the tips; 1 around the belt, where the meridian adds a sixteenth.
    assert sizes[tip] == pytest.approx(0.4 / 4, rel=0.1)
    assert sizes[belt] == pytest.approx(0.4, rel=0.1)
    a, b = edges(np.asarray(mesh.triangles)).vertices.T
    away = np.linalg.norm(vertices[a] - vertices[b], axis=1)
    assert np.all(np.abs(sizes[a] - sizes[b]) <= 0.25 * away * (1 + 1e-12))
    new = remesh(mesh, x, sizes)
    lengths = edge_lengths(new.mesh, new.x)
    assert np.max(lengths) > 2.5 * np.min(lengths)
    assert quality(new.mesh, new.x).min_angle > 25


def test_area_changes_by_the_error_of_interpolation_only():
    errors = []
    for level in (2, 3):
        mesh, x = ellipsoid((1.0, 1.0, 1.5), level, 2)
        new = remesh(mesh, x)
        errors.append(abs(float(area(new.mesh, new.x) / area(mesh, x)) - 1))
    assert errors[0] < 1e-3 and observed_order([1, 1 / 2], errors) > 3, errors


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_torus_keeps_its_hole_and_its_degree(degree):
    mesh, x = torus(level=1, degree=degree)
    new = remesh(mesh, x)
    assert new.mesh.degree == degree and new.mesh.genus == 1
    rho = np.linalg.norm(np.asarray(new.x)[:, :2], axis=1)
    old = np.linalg.norm(np.asarray(x)[:, :2], axis=1)
    tube = np.hypot(old - 0.5 * (old.min() + old.max()), np.asarray(x)[:, 2]).max()
    on_tube = np.hypot(rho - 0.5 * (old.min() + old.max()), np.asarray(new.x)[:, 2])
    np.testing.assert_allclose(on_tube, tube, rtol=0.05)


def test_fields_come_along():
    mesh, x = red_cell(level=1, degree=2)
    new = remesh(mesh, x, 0.4)
    u = jnp.stack([x @ jnp.array([1.0, -2.0, 0.5]), jnp.ones(len(x))], axis=1)
    y = new.transfer(x)
    expected = jnp.stack([y @ jnp.array([1.0, -2.0, 0.5]), jnp.ones(len(y))], axis=1)
    np.testing.assert_allclose(new.transfer(u), expected, atol=1e-12)
    np.testing.assert_allclose(new.transfer(u[:, 0]), expected[:, 0], atol=1e-12)


def test_every_change_of_a_triangulation_keeps_it_closed():
    """Random splits, collapses and flips; those that would spoil it are refused."""
    mesh, x = icosphere(1, degree=1)
    changing = Triangulation(np.asarray(mesh.triangles), np.asarray(x))
    rng = np.random.default_rng(0)
    done = dict.fromkeys(("split", "collapse", "flip"), 0)
    for _ in range(600):
        a, b = (lambda pairs: pairs[rng.integers(len(pairs))])(changing.edges())
        what = rng.choice(["split", "collapse", "collapse", "flip"])
        if what == "split":
            done[what] += changing.split(a, b) > 0
        else:
            act = changing.collapse(a, b, 1.0) if what == "collapse" else changing.flip(a, b)
            done[what] += act
    assert min(done.values()) > 20
    triangles, vertices = changing.arrays()
    found = check_mesh(SurfaceMesh(triangles, 1, len(vertices)), vertices)
    assert found.ok and found.euler_characteristic == 2


def test_a_tetrahedron_cannot_lose_an_edge():
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    x = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    changing = Triangulation(triangles, x)
    assert not any(changing.collapse(a, b, 10.0) for a, b in changing.edges())
    assert not any(changing.flip(a, b) for a, b in changing.edges())


MESH, X = icosphere(1, degree=2)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (0.0, "positive and finite"),
        (np.nan, "positive and finite"),
        (np.ones(7), r"one for each of 42 vertices; got shape \(7,\)"),
        (1e-4, "triangles, more than 500,000"),
    ],
)
def test_sizes_that_make_no_sense_are_refused(size, message):
    with pytest.raises(ValueError, match=message):
        remesh(MESH, X, size)


def test_sizes_too_large_for_the_bends_are_named():
    mesh, x = ellipsoid((1.0, 1.0, 3.0), 1, 4)
    with pytest.raises(RuntimeError, match="Ask for a smaller `size`"):
        remesh(mesh, x)
    with pytest.raises(ValueError, match="`bend`"):
        size_by_curvature(mesh, x, 0.0)
    with pytest.raises(ValueError, match="`smallest`"):
        size_by_curvature(mesh, x, smallest=2.0, largest=1.0)


@pytest.mark.parametrize(("shape", "more"), [(ellipsoid, 7), (ellipsoid, -5), (torus, 0)])
def test_a_number_of_vertices_is_met_exactly(shape, more):
    mesh, x = shape(level=1, degree=2)
    new = remesh(mesh, x, n_vertices=mesh.n_vertices + more)
    assert new.mesh.n_vertices == mesh.n_vertices + more and new.mesh.genus == mesh.genus
    assert quality(new.mesh, new.x).min_angle > 22
    # With the same number, all arrays of a computation have the shapes that they had.
    if not more:
        assert new.mesh.cells.shape == mesh.cells.shape and new.x.shape == x.shape
        assert new.mesh.n_node_pairs == mesh.n_node_pairs


def test_a_sphere_has_four_vertices_at_least():
    assert remesh(MESH, X, n_vertices=4).mesh.n_vertices == 4
    with pytest.raises(ValueError, match="`n_vertices` must be at least 4 for this surface; got 3"):
        remesh(MESH, X, n_vertices=3)

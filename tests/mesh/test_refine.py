"""Higher degree and finer triangles: orders of the lifting, and what stays unchanged."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.mesh import (
    SurfaceMesh,
    check_mesh,
    ellipsoid,
    icosphere,
    prolongate,
    quality,
    raise_degree,
    refine,
    torus,
)
from jaxwillmore.mesh._lifting import max_normals, vertex_normals
from jaxwillmore.reference import lagrange_basis, lagrange_nodes

from ..helpers import observed_order

XI = np.array([[0.2, 0.3], [0.5, 0.0], [0.1, 0.85]])


def points_at(mesh, x, xi):
    basis = lagrange_basis(mesh.degree, xi)
    return np.einsum("ql,tld->tqd", basis, np.asarray(x)[np.asarray(mesh.cells)])


def distance_to_ellipsoid(x):
    """To second order in the distance, for semi-axes 1, 1, 2."""
    x = np.asarray(x)
    scaled = x / np.array([1.0, 1.0, 2.0])
    gradient = 2 * scaled / np.array([1.0, 1.0, 2.0])
    return np.abs((scaled**2).sum(axis=1) - 1) / np.linalg.norm(gradient, axis=1)


def rough_ellipsoid(level):
    """Vertices on the ellipsoid, moved along it by up to a fifth of an edge."""
    mesh, x = icosphere(level, degree=1)
    step = 0.2 * quality(mesh, x).h_min
    x = np.asarray(x) + np.random.default_rng(0).uniform(-step, step, x.shape)
    return mesh, x / np.linalg.norm(x, axis=1, keepdims=True) * np.array([1.0, 1.0, 2.0])


@pytest.mark.parametrize("degree", [2, 3])
def test_lifted_sphere_is_of_order_four(degree):
    errors = []
    for level in (1, 2, 3):
        _, x = raise_degree(*icosphere(level, degree=1), degree)
        errors.append(float(jnp.abs(jnp.linalg.norm(x, axis=1) - 1).max()))
    assert observed_order([1, 1 / 2, 1 / 4], errors) > 3.5, errors


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("make", [lambda level: ellipsoid(level=level, degree=1), rough_ellipsoid])
def test_lifted_ellipsoid_is_of_order_three_or_better(make, degree):
    errors = []
    for level in (2, 3, 4):
        mesh, vertices = make(level)
        _, x = raise_degree(mesh, vertices, degree)
        errors.append(distance_to_ellipsoid(x).max())
    assert observed_order([1, 1 / 2, 1 / 4], errors) > 2.95, errors


def test_vertex_normals_are_of_order_two_on_a_rough_mesh_where_those_of_max_are_not():
    errors, errors_of_max = [], []
    for level in (3, 4, 5):
        mesh, x = rough_ellipsoid(level)
        exact = x / np.array([1.0, 1.0, 4.0])
        exact /= np.linalg.norm(exact, axis=1, keepdims=True)
        triangles = np.asarray(mesh.triangles)
        errors.append(np.abs(vertex_normals(triangles, x) - exact).max())
        errors_of_max.append(np.abs(max_normals(triangles, x) - exact).max())
    assert observed_order([1, 1 / 2, 1 / 4], errors) > 1.8, errors
    assert observed_order([1, 1 / 2, 1 / 4], errors_of_max) < 1.5, errors_of_max


def test_normals_of_max_are_exact_on_a_sphere_however_rough():
    mesh, x = icosphere(1, degree=1)
    x = np.asarray(x) + np.random.default_rng(0).uniform(-0.1, 0.1, x.shape)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    np.testing.assert_allclose(max_normals(np.asarray(mesh.triangles), x), x, atol=1e-13)


def test_normals_where_neighbours_cannot_say_more_are_those_of_max():
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    x = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    np.testing.assert_allclose(
        np.abs(vertex_normals(triangles, x)), np.abs(x) / np.sqrt(3), atol=1e-14
    )


@pytest.mark.parametrize("make", [icosphere, torus])
def test_vertices_stay_and_the_lifting_is_a_proper_surface(make):
    flat, x = make(level=1, degree=1)
    for degree in (2, 3, 4):
        mesh, nodes = raise_degree(flat, x, degree)
        np.testing.assert_array_equal(nodes[: flat.n_nodes], x)
        np.testing.assert_array_equal(mesh.triangles, flat.triangles)
        assert check_mesh(mesh, nodes).ok


def test_triangles_alone_are_enough():
    mesh, x = icosphere(1, degree=1)
    lifted, nodes = raise_degree(np.asarray(mesh.triangles), np.asarray(x), 2)
    np.testing.assert_array_equal(nodes, raise_degree(mesh, x, 2)[1])
    assert lifted.n_nodes == 162


@pytest.mark.parametrize("degree", [2, 3])
def test_curved_triangles_keep_their_shape(degree):
    mesh, x = ellipsoid(level=0, degree=degree)
    higher, nodes = raise_degree(mesh, x, 4)
    np.testing.assert_allclose(points_at(higher, nodes, XI), points_at(mesh, x, XI), atol=1e-14)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_refining_curved_triangles_keeps_the_surface(degree):
    mesh, x = ellipsoid(level=0, degree=degree)
    fine, nodes = refine(mesh, x)
    assert (fine.n_cells, fine.n_vertices) == (80, 42)
    children = points_at(fine, nodes, XI).reshape(20, 4, len(XI), 3)
    # The middle child runs from the midpoint of edge 0→1 to those of 1→2 and 2→0.
    middle = np.array([0.5, 0.0]) + XI @ np.array([[0.0, 0.5], [-0.5, 0.5]])
    np.testing.assert_allclose(children[:, 3], points_at(mesh, x, middle), atol=1e-14)
    np.testing.assert_allclose(children[:, 0], points_at(mesh, x, XI / 2), atol=1e-14)


def test_refining_flat_triangles_uses_the_lifting():
    mesh, x = icosphere(1, degree=1)
    fine, nodes = refine(mesh, x)
    assert (fine.n_nodes, fine.degree, fine.euler_characteristic) == (162, 1, 2)
    _, lifted = raise_degree(mesh, x, 2)
    np.testing.assert_allclose(nodes, lifted, atol=1e-14)  # the midpoints of the edges


def test_projection_puts_all_nodes_on_the_exact_surface():
    onto_sphere = lambda x: x / jnp.linalg.norm(x, axis=1, keepdims=True)
    for mesh, x in (
        raise_degree(*icosphere(1, degree=1), 3, project=onto_sphere),
        refine(*icosphere(1, degree=2), project=onto_sphere),
    ):
        assert isinstance(mesh, SurfaceMesh)
        np.testing.assert_allclose(jnp.linalg.norm(x, axis=1), 1.0, rtol=1e-14)


def test_lower_degree_and_wrong_numbers_of_nodes_are_refused():
    mesh, x = icosphere(0, degree=2)
    with pytest.raises(ValueError, match="at least 2, the present one; got 1"):
        raise_degree(mesh, x, 1)
    with pytest.raises(ValueError, match=r"shape \(42, 3\); got \(41, 3\)"):
        refine(mesh, x[1:])


def test_nodes_of_degree_four_on_the_lifting_do_not_depend_on_the_path():
    mesh, x = icosphere(1, degree=1)
    direct = raise_degree(mesh, x, 4)
    # The lifting is cubic, so degree 3 already holds all of it.
    detour = raise_degree(*raise_degree(mesh, x, 3), 4)
    np.testing.assert_allclose(direct[1], detour[1], atol=1e-14)
    np.testing.assert_allclose(
        points_at(*direct, lagrange_nodes(2)), points_at(*detour, lagrange_nodes(2)), atol=1e-14
    )


@pytest.mark.parametrize("degree", [2, 3])
def test_prolongation_leaves_a_finite_element_function_unchanged(degree):
    mesh, x = ellipsoid(level=1, degree=degree)
    u = jnp.stack([jnp.sin(3 * x), jnp.cos(x)], axis=1)
    finer, y = refine(mesh, x)
    # The surface is a finite element function of itself.
    np.testing.assert_allclose(prolongate(mesh, x), y, atol=1e-15)
    there = prolongate(mesh, u)
    assert there.shape == (finer.n_nodes, 2, 3)
    # Corner 0 of a parent is corner 0 of its first child, whose centre is a point of the parent.
    inside = np.array([[1 / 6, 1 / 6]])
    child = points_at(finer, there.reshape(-1, 6), 2 * inside)[::4]
    np.testing.assert_allclose(child, points_at(mesh, u.reshape(-1, 6), inside), atol=1e-14)
    with pytest.raises(ValueError, match="rows"):
        prolongate(finer, u)

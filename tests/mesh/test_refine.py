"""Higher degree and finer triangles: orders of the lifting, and what stays unchanged."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import Willmore
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
from jaxwillmore.mesh._lifting import charts, creases
from jaxwillmore.mesh._stencils import max_normals
from jaxwillmore.reference import lagrange_basis
from jaxwillmore.surface import area, recover_mean_curvature, volume

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


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize(
    "make", [lambda level: ellipsoid(level=level, degree=1), rough_ellipsoid], ids=["even", "rough"]
)
def test_new_nodes_are_on_a_smooth_surface_with_order_five(make, degree):
    errors = []
    for level in (2, 3, 4):
        mesh, vertices = make(level)
        _, x = raise_degree(mesh, vertices, degree)
        errors.append(distance_to_ellipsoid(x).max())
    assert observed_order([1, 1 / 2, 1 / 4], errors) > 4.5, errors
    assert errors[-1] < 3e-5


def torus_of_a_file(R=1.0, r=0.4, around=48, along=24):
    """Quadrilaterals of equal angles, each cut in two, as modelling programs write them."""
    u, v = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    number = lambda a, b: (u + a) % around * along + (v + b) % along
    square = [number(*corner) for corner in ((0, 0), (1, 0), (1, 1), (0, 1))]
    cells = np.stack([square[k] for k in (0, 1, 2, 0, 2, 3)], axis=-1).reshape(-1, 3)
    u, v = 2 * np.pi * u / around, 2 * np.pi * v / along
    rho = R + r * np.cos(v)
    x = np.stack([rho * np.cos(u), rho * np.sin(u), r * np.sin(v)], axis=-1)
    return SurfaceMesh(cells, 1, around * along), x.reshape(-1, 3)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_a_torus_of_another_program_keeps_its_energy_and_curvature(degree):
    """Nodal H as with inner nodes on the torus itself, of degree 2 as good as of degree 1."""
    R, r = 1.0, 0.4
    mesh, x = raise_degree(*torus_of_a_file(R, r), degree)
    exact = 2 * np.pi**2 * R**2 / (r * np.sqrt(R**2 - r**2))
    assert abs(float(Willmore()(mesh, x)) / exact - 1) < 4e-4

    def onto(x):
        centre = x.at[:, 2].set(0.0)
        centre *= R / jnp.linalg.norm(centre, axis=1, keepdims=True)
        out = x - centre
        return centre + r * out / jnp.linalg.norm(out, axis=1, keepdims=True)

    def error(x):
        rho = jnp.linalg.norm(x[:, :2], axis=1)
        H = recover_mean_curvature(mesh, x)
        return float(jnp.max(jnp.abs(H - 1 / r - (rho - R) / (r * rho))))

    assert error(x) < max(1.15 * error(onto(x)), 0.06)


def test_creases_stay_as_sharp_as_they_are():
    corners = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    cells = np.array([[q[k] for k in half] for q in quads for half in ((0, 1, 2), (0, 2, 3))])
    assert len(creases(cells, corners)) == 12
    for degree in (2, 4):
        mesh, x = raise_degree(SurfaceMesh(cells, 1, 8), corners, degree)
        assert float(area(mesh, x)) == pytest.approx(6.0, rel=1e-14)
        assert float(volume(mesh, x)) == pytest.approx(1.0, rel=1e-14)


def lens(angle):
    """Two caps of spheres with a common rim of radius 1; where they lie, and their centres' height.

    `angle` is that of a cap, in radians, seen from its centre.
    """
    x = np.concatenate([np.eye(3), -np.eye(3)])
    cells = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    mesh = SurfaceMesh(np.array(cells), 1, 6)
    for _ in range(4):  # an octahedron: edges of the mesh are on the rim
        mesh, x = refine(mesh, x, lambda p: p / jnp.linalg.norm(p, axis=1, keepdims=True))
    x, R = np.asarray(x), 1 / np.sin(angle)
    polar = np.arccos(np.minimum(np.abs(x[:, 2]), 1.0)) * 2 * angle / np.pi
    flat = np.linalg.norm(x[:, :2], axis=1, keepdims=True)
    out = R * np.sin(polar)[:, None] * x[:, :2] / np.where(flat > 0, flat, 1.0)
    height = np.sign(np.round(x[:, 2], 12)) * R * (np.cos(polar) - np.cos(angle))
    return mesh, np.column_stack([out, height]), R, R * np.cos(angle)


def test_no_polynomial_looks_across_a_crease():
    """A lens bent by 70° at its rim: but for triangles there, new nodes are on its two caps."""
    mesh, x, R, depth = lens(np.radians(55))
    cells = np.asarray(mesh.triangles)
    rim = np.abs(x[:, 2]) < 1e-9
    assert np.sum(rim) == len(creases(cells, x)) == 64
    np.testing.assert_array_equal(charts(cells, x).smooth, ~rim)
    lifted, nodes = raise_degree(mesh, x, 2)
    nodes = np.asarray(nodes)
    inside = np.setdiff1d(np.arange(len(nodes)), np.asarray(lifted.cells)[rim[cells].any(axis=1)])
    from_centre = nodes[inside] * [1.0, 1.0, 0.0]
    from_centre[:, 2] = np.abs(nodes[inside, 2]) + depth
    assert np.abs(np.linalg.norm(from_centre, axis=1) - R).max() < 2e-6


def test_normals_of_max_are_exact_on_a_sphere_however_rough():
    mesh, x = icosphere(1, degree=1)
    x = np.asarray(x) + np.random.default_rng(0).uniform(-0.1, 0.1, x.shape)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    np.testing.assert_allclose(max_normals(np.asarray(mesh.triangles), x), x, atol=1e-13)


def test_where_neighbours_tell_nothing_triangles_stay_flat():
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    x = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    assert not np.any(charts(triangles, x).smooth)
    _, lifted = raise_degree(triangles, x, 2)
    assert np.all(np.sort(np.abs(lifted[4:]), axis=1) == [0.0, 0.0, 1.0])


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


def test_every_degree_has_its_nodes_on_the_same_surface():
    mesh, x = icosphere(1, degree=1)
    for degree in (2, 4):
        middles = points_at(*raise_degree(mesh, x, degree), np.array([[0.5, 0.0], [0.5, 0.5]]))
        if degree == 2:
            expected = middles
    np.testing.assert_allclose(middles, expected, atol=1e-14)


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

"""SurfaceMesh: counts, topology, and what it refuses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.mesh import SurfaceMesh, icosphere, torus

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("make, genus", [(icosphere, 0), (torus, 1)])
def test_counts_and_topology(make, genus, degree):
    mesh, x = make(level=1, degree=degree)
    assert mesh.euler_characteristic == 2 - 2 * genus
    assert mesh.genus == genus
    assert x.shape == (mesh.n_nodes, 3)
    assert mesh.n_vertices == len(np.unique(mesh.triangles))
    assert mesh.cells.dtype == jnp.int32


def test_two_pieces_add_their_genera():
    one, two = (make(level=1, degree=1)[0] for make in (icosphere, torus))
    cells = jnp.concatenate([one.cells, two.cells + one.n_nodes])
    assert SurfaceMesh(cells, 1, one.n_nodes + two.n_nodes).genus == 1


def test_mesh_is_a_pytree_of_its_cells():
    mesh, _ = icosphere(0, degree=2)
    (leaf,) = jax.tree.leaves(mesh)
    assert leaf is mesh.cells
    assert jax.jit(lambda mesh: mesh.triangles.sum())(mesh) == mesh.triangles.sum()
    assert mesh.n_vertices == 12


@pytest.mark.parametrize(
    "cells, degree, n_nodes, message",
    [
        (TETRAHEDRON, 2, 4, r"shape \(cells, 6\) for degree 2; got \(4, 3\)"),
        (TETRAHEDRON, 5, 4, "must be 1, 2, 3 or 4"),
        (TETRAHEDRON[:3], 1, 4, "even, positive number of triangles; got 3"),
        (TETRAHEDRON[:2], 1, 4, "edges do not have two triangles"),
        (TETRAHEDRON, 1, 3, "names node 3, but there are only 3"),
        (TETRAHEDRON, 1, 6, r"2 nodes belong to no triangle, the first ones are \[4, 5\]"),
        (TETRAHEDRON - 1, 1, 4, "values from -1 to 2"),
        (TETRAHEDRON + 0.5, 1, 4, "must hold integers"),
        (TETRAHEDRON * [[1], [1], [1], [0]], 1, 4, "same vertex twice"),
        (np.r_[TETRAHEDRON[:3], TETRAHEDRON[3:, ::-1]], 1, 4, "3 have two triangles of opposite"),
    ],
)
def test_what_is_no_closed_surface_is_refused(cells, degree, n_nodes, message):
    with pytest.raises(ValueError, match=message):
        SurfaceMesh(cells, degree, n_nodes)


@pytest.mark.parametrize("degree", [3, 4])
def test_edge_nodes_in_the_wrong_direction_are_refused(degree):
    mesh, _ = icosphere(0, degree=degree)
    cells = np.array(mesh.cells)
    cells[4, 3 : degree + 2] = cells[4, 3 : degree + 2][::-1]
    with pytest.raises(ValueError, match="do not share the nodes inside an edge"):
        SurfaceMesh(cells, degree, mesh.n_nodes)


def test_vertices_must_come_first():
    mesh, _ = icosphere(0, degree=2)
    renumbered = mesh.n_nodes - 1 - np.array(mesh.cells)
    with pytest.raises(ValueError, match="numbered before all other nodes"):
        SurfaceMesh(renumbered, 2, mesh.n_nodes)

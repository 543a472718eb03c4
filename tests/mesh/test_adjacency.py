"""Edges and the numbering of nodes inside them."""

import numpy as np
import pytest

from jaxwillmore.mesh import icosphere
from jaxwillmore.mesh._adjacency import (
    CHILD_CORNERS,
    directed_edges,
    edges,
    lagrange_cells,
    split_triangles,
)

TRIANGLES = np.array(icosphere(1, degree=1)[0].triangles)


def test_every_edge_of_a_closed_surface_has_two_triangles_in_opposite_directions():
    edge = edges(TRIANGLES)
    np.testing.assert_array_equal(edge.n_cells, 2)
    assert len(edge.vertices) == 3 * len(TRIANGLES) // 2
    directed = directed_edges(TRIANGLES)
    np.testing.assert_array_equal(np.sort(directed, axis=-1), edge.vertices[edge.of_cell])
    np.testing.assert_array_equal(edge.is_forward, directed[..., 0] < directed[..., 1])
    assert edge.is_forward.sum() == len(edge.vertices)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_node_numbers_are_dense_and_shared_by_neighbours(degree):
    cells, n_nodes = lagrange_cells(TRIANGLES, 42, degree)
    numbers, uses = np.unique(cells, return_counts=True)
    np.testing.assert_array_equal(numbers, np.arange(n_nodes))
    on_edges = slice(42, 42 + 120 * (degree - 1))
    np.testing.assert_array_equal(uses[on_edges], 2)
    np.testing.assert_array_equal(uses[on_edges.stop :], 1)


def test_children_tile_their_parent():
    children, edge = split_triangles(TRIANGLES, 42)
    assert children.shape == (4 * len(TRIANGLES), 3)
    np.testing.assert_array_equal(edges(children).n_cells, 2)
    np.testing.assert_array_equal(children[0::4, 0], TRIANGLES[:, 0])
    np.testing.assert_array_equal(children[1::4, 1], TRIANGLES[:, 1])
    np.testing.assert_array_equal(children[2::4, 2], TRIANGLES[:, 2])
    np.testing.assert_array_equal(children[3::4], 42 + edge.of_cell)
    a, b, c = np.moveaxis(CHILD_CORNERS, 1, 0)
    np.testing.assert_array_equal(np.linalg.det(np.stack([b - a, c - a], axis=1)), 0.25)

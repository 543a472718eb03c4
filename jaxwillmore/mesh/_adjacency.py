"""Who touches whom: edges of a triangulation and the numbering of nodes of higher degree.

NumPy on the host; connectivity is built once, before anything is traced. A local edge is 0, 1 or
2 and runs 0→1, 1→2, 2→0, so that neighbouring triangles of an oriented surface run through their
common edge in opposite directions.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..reference import n_local_nodes

Triangles = Int[np.ndarray, "cells 3"]


class Edges(NamedTuple):
    """Undirected edges of a triangulation, in the order of their (low, high) vertex pair."""

    vertices: Int[np.ndarray, "edges 2"]
    """End points, the lower number first."""
    of_cell: Int[np.ndarray, "cells 3"]
    """Number of the edge under local edge 0→1, 1→2, 2→0 of each triangle."""
    is_forward: Bool[np.ndarray, "cells 3"]
    """Whether the triangle runs through that edge from the lower to the higher number."""
    n_cells: Int[np.ndarray, " edges"]
    """Number of triangles at each edge: 2 everywhere on a closed surface."""


def directed_edges(triangles: Triangles) -> Int[np.ndarray, "cells 3 2"]:
    """Start and end vertex of every local edge."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1)


def edges(triangles: Triangles) -> Edges:
    """All edges of a triangulation, each once."""
    directed = directed_edges(triangles.astype(np.int64))
    low, high = directed.min(axis=-1), directed.max(axis=-1)
    stride = int(high.max(initial=0)) + 1  # one integer per pair sorts faster than rows do
    keys, of_cell, n_cells = np.unique(low * stride + high, return_inverse=True, return_counts=True)
    return Edges(
        vertices=np.stack([keys // stride, keys % stride], axis=-1),
        of_cell=of_cell.reshape(triangles.shape),
        is_forward=directed[..., 0] == low,
        n_cells=n_cells,
    )


def lagrange_cells(
    triangles: Triangles, n_vertices: int, degree: int
) -> tuple[Int[np.ndarray, "cells local"], int]:
    """Number the nodes of `degree` on a triangulation: vertices, then edges, then interiors.

    The nodes inside an edge are numbered from its lower to its higher vertex. A triangle that
    runs through the edge the other way lists them in reverse, so that its local order agrees
    with `jaxwillmore.reference.lagrange_nodes` and both neighbours mean the same points.

    **Returns:** the cells and the number of nodes.
    """
    n_cells = len(triangles)
    per_edge = degree - 1
    per_cell = n_local_nodes(degree) - 3 * degree
    edge = edges(triangles)
    along = np.arange(per_edge)
    position = np.where(edge.is_forward[..., None], along, per_edge - 1 - along)
    on_edges = n_vertices + per_edge * edge.of_cell[..., None] + position
    first_interior = n_vertices + per_edge * len(edge.vertices)
    inside = first_interior + np.arange(per_cell * n_cells).reshape(n_cells, per_cell)
    cells = np.concatenate([triangles, on_edges.reshape(n_cells, -1), inside], axis=1)
    return cells, first_interior + per_cell * n_cells


def split_triangles(
    triangles: Triangles, n_vertices: int
) -> tuple[Int[np.ndarray, "4*cells 3"], Edges]:
    """Cut every triangle into four at the midpoints of its edges.

    Vertex `n_vertices + e` is the midpoint of edge e. The four children of a triangle follow each
    other: at corner 0, 1, 2, then the middle one; see `CHILD_CORNERS`.
    """
    edge = edges(triangles)
    local = np.concatenate([triangles, n_vertices + edge.of_cell], axis=1)
    return local[:, _CHILDREN].reshape(-1, 3), edge


# Local numbers 0, 1, 2 are the corners of the parent, 3, 4, 5 the midpoints of its edges.
_CHILDREN = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])

_SIX = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])

CHILD_CORNERS: Float[np.ndarray, "4 3 2"] = _SIX[_CHILDREN]
"""Corners of the four children in the reference triangle of the parent."""


def scatter(
    cells: Int[np.ndarray, "cells local"], n_nodes: int, values: Float[np.ndarray, "cells local d"]
) -> Float[np.ndarray, "nodes d"]:
    """One value per node from values per cell; where cells share a node their values agree."""
    out = np.empty((n_nodes, values.shape[-1]))
    out[cells] = values
    return out

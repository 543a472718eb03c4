"""Defects of a triangulation that its integers alone show: each function finds one kind."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ._adjacency import Edges, Triangles, directed_edges


def repeated_corners(triangles: Triangles) -> Bool[np.ndarray, " cells"]:
    """Triangles that name a vertex twice."""
    return np.any(triangles == np.roll(triangles, 1, axis=1), axis=1)


def repeats_of_faces(triangles: Triangles) -> Bool[np.ndarray, " cells"]:
    """Triangles with the same three vertices as an earlier one, in whatever order."""
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    repeated = np.ones(len(triangles), dtype=bool)
    repeated[first] = False
    return repeated


def unused_vertices(triangles: Triangles, n_vertices: int) -> Int[np.ndarray, " unused"]:
    """Vertices that no triangle names."""
    used = np.zeros(n_vertices, dtype=bool)
    used[triangles] = True
    return np.flatnonzero(~used)


def pinched_vertices(triangles: Triangles, edge: Edges) -> Int[np.ndarray, " pinched"]:
    """Vertices whose triangles do not form a single fan, so that pieces touch in a point only.

    A corner is a triangle at a vertex. Corners at a common vertex are neighbours where their
    triangles share an edge; each connected set of corners is one fan.
    """
    n_corners = triangles.size
    corner = np.arange(n_corners).reshape(triangles.shape)
    # Local edge e has its ends at the corners e and e + 1; sort them by vertex number.
    first, second = corner, np.roll(corner, -1, axis=1)
    low = np.where(edge.is_forward, first, second).ravel()
    high = np.where(edge.is_forward, second, first).ravel()
    order = np.argsort(edge.of_cell.ravel(), kind="stable")
    numbers = edge.of_cell.ravel()[order]
    same = numbers[1:] == numbers[:-1]
    left, right = order[:-1][same], order[1:][same]
    start = np.concatenate([low[left], high[left]])
    end = np.concatenate([low[right], high[right]])
    _, fan = connected_components(_graph(start, end, n_corners), directed=False)
    fans = np.unique(np.stack([triangles.ravel(), fan], axis=1), axis=0)[:, 0]
    vertex, count = np.unique(fans, return_counts=True)
    return vertex[count > 1]


class Orientation(NamedTuple):
    """How triangles that share edges are turned relative to each other."""

    component: Int[np.ndarray, " cells"]
    """Piece of the surface each triangle belongs to, by shared edges."""
    is_flipped: Bool[np.ndarray, " cells"]
    """Triangles turned against the majority of their piece."""
    one_sided: Int[np.ndarray, " pieces"]
    """Pieces that cannot be oriented, like a Klein bottle."""


def orientation(triangles: Triangles, edge: Edges) -> Orientation:
    """Compare the orientations of neighbours, on the double cover of the surface.

    The cover has each triangle twice, as it is and reversed. Across an edge with two triangles a
    sheet continues where both run through it in opposite directions. A piece is orientable when
    its cover falls into two parts; the part with more triangles as they are is the majority.
    """
    n = len(triangles)
    order = np.argsort(edge.of_cell.ravel(), kind="stable")
    order = order[edge.n_cells[edge.of_cell.ravel()[order]] == 2]
    one, other = order[::2] // 3, order[1::2] // 3
    forward = edge.is_forward.ravel()
    agree = forward[order[::2]] != forward[order[1::2]]
    start = np.concatenate([one, one + n])
    end = np.concatenate([np.where(agree, other, other + n), np.where(agree, other + n, other)])
    _, sheet = connected_components(_graph(start, end, 2 * n), directed=False)
    _, component = connected_components(_graph(one, other, n), directed=False)
    upper, lower = sheet[:n], sheet[n:]
    size = np.bincount(upper, minlength=sheet.max(initial=-1) + 1)
    one_sided = np.unique(component[upper == lower])
    # On a tie the triangles that agree with the first one of the piece are the majority.
    first = np.unique(component, return_index=True)[1]
    tie_winner = upper[first][component]
    is_flipped = (size[upper] < size[lower]) | (
        (size[upper] == size[lower]) & (upper != tie_winner)
    )
    is_flipped[np.isin(component, one_sided)] = False
    return Orientation(component, is_flipped, one_sided)


def torn_edges(triangles: Triangles, edge: Edges) -> Int[np.ndarray, "torn 2"]:
    """Edges whose two triangles run through them in the same direction."""
    balance = np.zeros(len(edge.vertices), dtype=int)
    np.add.at(balance, edge.of_cell, np.where(edge.is_forward, 1, -1))
    return edge.vertices[(edge.n_cells == 2) & (balance != 0)]


def vertex_pieces(triangles: Triangles, n_vertices: int) -> Int[np.ndarray, " vertices"]:
    """A label per vertex, equal for vertices that a chain of edges joins."""
    start, end = directed_edges(triangles).reshape(-1, 2).T
    return connected_components(_graph(start, end, n_vertices), directed=False)[1]


def n_pieces(triangles: Triangles, n_vertices: int) -> int:
    """Number of pieces of a surface that share no vertex; unused vertices do not count."""
    return len(np.unique(vertex_pieces(triangles, n_vertices)[triangles]))


def _graph(start, end, n: int) -> coo_array:
    return coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(n, n))

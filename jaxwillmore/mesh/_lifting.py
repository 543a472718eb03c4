"""A smooth surface through the vertices of a triangulation: curved point-normal triangles."""

import numpy as np
from jaxtyping import Float

from ..reference import lagrange_basis
from ._adjacency import Triangles, directed_edges


def vertex_normals(
    triangles: Triangles, x: Float[np.ndarray, "vertices 3"]
) -> Float[np.ndarray, "vertices 3"]:
    """Unit normals at the vertices, of second order in h also on irregular triangulations.

    Over the plane of the normals of `max_normals` a quadratic polynomial through the vertex is
    fitted to its neighbours and theirs, with weights 1/distance²; its slope corrects the normal.
    Where the neighbours do not determine the polynomial, or where it would tilt the normal by
    more than 45°, as at a sharp edge, the correction is left out.
    """
    rough = max_normals(triangles, x)
    start, end = _second_neighbours(triangles, len(x))
    same_side = np.sum(rough[start] * rough[end], axis=1) > 0
    start, end = start[same_side], end[same_side]

    chord = x[end] - x[start]
    distance = np.linalg.norm(chord, axis=1)
    distance = np.where(distance > 0, distance, 1.0)
    counts = np.bincount(start, minlength=len(x))
    reach = np.bincount(start, distance, minlength=len(x)) / np.maximum(counts, 1)
    chord /= np.where(reach > 0, reach, 1.0)[start, None]  # a fit in units of order one
    t1, t2 = _tangents(rough)
    u, v, w = (np.sum(chord * axis[start], axis=1) for axis in (t1, t2, rough))
    terms = np.stack([u, v, u * u, u * v, v * v, w], axis=1) * (reach[start] / distance)[:, None]
    moments = np.zeros((len(x), 6, 6))
    for i, j in zip(*np.triu_indices(6), strict=True):
        moments[:, i, j] = np.bincount(start, terms[:, i] * terms[:, j], minlength=len(x))
        moments[:, j, i] = moments[:, i, j]
    matrix, right = moments[:, :5, :5], moments[:, :5, 5:]
    spectrum = np.linalg.eigvalsh(matrix)
    usable = spectrum[:, 0] > 1e-6 * spectrum[:, -1]
    slope = np.zeros((len(x), 2))
    slope[usable] = np.linalg.solve(matrix[usable], right[usable])[:, :2, 0]
    slope[np.sum(slope**2, axis=1) > 1.0] = 0.0
    normals = rough - slope[:, :1] * t1 - slope[:, 1:] * t2
    return normals / np.sqrt(1.0 + np.sum(slope**2, axis=1, keepdims=True))


def max_normals(
    triangles: Triangles, x: Float[np.ndarray, "vertices 3"]
) -> Float[np.ndarray, "vertices 3"]:
    r"""Unit normals at the vertices: triangle normals with the weights of Max.

    $$ \nu \propto \sum_T \frac{e_1 \times e_2}{|e_1|^2 |e_2|^2} $$

    over the triangles at the vertex, with $e_1, e_2$ their edges there. Exact when the vertex and
    its neighbours lie on a sphere. A vertex whose sum vanishes gets the zero vector, for which
    the lifting is flat.

    ??? cite "Reference"
        Max (1999), *J. Graphics Tools* 4(2), 1–6.
    """
    corners = x[triangles]
    out = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    square = np.sum(out**2, axis=-1) * np.sum(back**2, axis=-1)
    weighted = np.cross(out, back) / np.where(square > 0, square, 1.0)[..., None]
    normals = np.zeros_like(x)
    np.add.at(normals, triangles, weighted)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


def lift(
    triangles: Triangles,
    x: Float[np.ndarray, "vertices 3"],
    xi: Float[np.ndarray, "points 2"],
) -> Float[np.ndarray, "cells points 3"]:
    """Points at `xi` on the curved point-normal triangle over every triangle.

    Each is a cubic Bézier patch that interpolates the vertices and is tangent to their planes.
    The curve over an edge depends on the two ends of the edge only, so neighbours meet.

    ??? cite "Reference"
        Vlachos, Peters, Boyd, Mitchell (2001), *Curved PN triangles*, Proc. I3D, 159–166, (1)–(3).
    """
    normals = vertex_normals(triangles, x)
    corner = x[triangles]
    # near_start[:, e] is the control point at a third of directed edge e, near_end at two thirds.
    pair = directed_edges(triangles)
    near_start = _third(x, normals, pair[..., 0], pair[..., 1])
    near_end = _third(x, normals, pair[..., 1], pair[..., 0])
    on_edges = (near_start.sum(axis=1) + near_end.sum(axis=1)) / 6
    centre = on_edges + 0.5 * (on_edges - corner.mean(axis=1))

    here = lagrange_basis(1, xi)
    following = np.roll(here, -1, axis=1)
    points = np.einsum("qc,tcd->tqd", here**3, corner)
    points += np.einsum("qe,ted->tqd", 3 * here**2 * following, near_start)
    points += np.einsum("qe,ted->tqd", 3 * here * following**2, near_end)
    points += np.einsum("q,td->tqd", 6 * here.prod(axis=1), centre)
    return points


def _third(x, normals, start, end):
    """A third of the way from `start` to `end`, moved into the tangent plane at `start`."""
    chord = x[end] - x[start]
    height = np.sum(chord * normals[start], axis=-1, keepdims=True)
    return x[start] + (chord - height * normals[start]) / 3


def _second_neighbours(triangles: Triangles, n_vertices: int):
    """Pairs (i, j), i ≠ j, of vertices joined by one or two edges, sorted by i."""
    from scipy.sparse import coo_array

    start, end = directed_edges(triangles).reshape(-1, 2).T
    ones = np.ones(2 * len(start), dtype=np.int32)
    both = (np.concatenate([start, end]), np.concatenate([end, start]))
    first = coo_array((ones, both), shape=2 * (n_vertices,)).tocsr()
    pairs = (first + first @ first).tocoo()
    i, j = pairs.coords
    return i[i != j], j[i != j]


def _tangents(normals):
    """Two unit vectors that complete each unit normal to an orthonormal frame."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    t1 = np.cross(normals, axis)
    length = np.linalg.norm(t1, axis=1, keepdims=True)
    t1 /= np.where(length > 0, length, 1.0)
    return t1, np.cross(normals, t1)

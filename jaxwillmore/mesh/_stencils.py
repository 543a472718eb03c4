"""The neighbours of every vertex, and theirs, as heights over the plane of its normal."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ._adjacency import Triangles, directed_edges


class Stencils(NamedTuple):
    """For every vertex the vertices around it, in units of their mean distance.

    **Attributes:**

    - `normals`, `tangents`: of the plane at every vertex.
    - `reach`: mean distance of the neighbours.
    - `at`, `seen`: vertex and neighbour of every pair.
    - `u`, `v`, `w`: coordinates of the neighbour in the plane, and its height, over `reach`.
    - `distance`: of the pair, over `reach`.
    """

    normals: Float[np.ndarray, "vertices 3"]
    tangents: tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, "vertices 3"]]
    reach: Float[np.ndarray, " vertices"]
    at: Int[np.ndarray, " pairs"]
    seen: Int[np.ndarray, " pairs"]
    u: Float[np.ndarray, " pairs"]
    v: Float[np.ndarray, " pairs"]
    w: Float[np.ndarray, " pairs"]
    distance: Float[np.ndarray, " pairs"]

    def every(self, step: int) -> "Stencils":
        """Those of every `step`-th vertex only; `at` counts these."""
        kept = self.at % step == 0
        pairs = (a[kept] for a in (self.seen, self.u, self.v, self.w, self.distance))
        tangents = self.tangents[0][::step], self.tangents[1][::step]
        normals, reach = self.normals[::step], self.reach[::step]
        return Stencils(normals, tangents, reach, self.at[kept] // step, *pairs)

    def moments(self, columns: Float[np.ndarray, "pairs columns"]):
        """Sums of all products of two columns, vertex by vertex."""
        n, count = len(self.reach), columns.shape[1]
        found = np.zeros((n, count, count))
        for i, j in zip(*np.triu_indices(count), strict=True):
            found[:, i, j] = np.bincount(self.at, columns[:, i] * columns[:, j], minlength=n)
            found[:, j, i] = found[:, i, j]
        return found


def stencils(
    triangles: Triangles,
    x: Float[np.ndarray, "vertices 3"],
    smooth: Bool[np.ndarray, " vertices"] | None = None,
) -> Stencils:
    """Neighbours on the same side of the surface; none is reached across a vertex not `smooth`."""
    normals = max_normals(triangles, x)
    t1, t2 = _tangents(normals)
    at, seen = _second_neighbours(triangles, np.ones(len(x), bool) if smooth is None else smooth)
    same_side = np.sum(normals[at] * normals[seen], axis=1) > 0
    at, seen = at[same_side], seen[same_side]
    chord = x[seen] - x[at]
    distance = np.linalg.norm(chord, axis=1)
    counts = np.bincount(at, minlength=len(x))
    reach = np.bincount(at, distance, minlength=len(x)) / np.maximum(counts, 1)
    reach = np.where(reach > 0, reach, 1.0)
    u, v, w = (np.sum(chord * axis[at], axis=1) / reach[at] for axis in (t1, t2, normals))
    distance = np.where(distance > 0, distance, 1.0) / reach[at]
    return Stencils(normals, (t1, t2), reach, at, seen, u, v, w, distance)


def powers(u, v) -> np.ndarray:
    """All monomials of degree one to four."""
    return np.stack([u ** (d - k) * v**k for d in range(1, 5) for k in range(d + 1)], axis=-1)


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


def _second_neighbours(triangles: Triangles, smooth: Bool[np.ndarray, " vertices"]):
    """Pairs (i, j), i ≠ j, of vertices joined by one edge, or two through a smooth vertex."""
    from scipy.sparse import coo_array, diags_array

    n = len(smooth)
    start, end = directed_edges(triangles).reshape(-1, 2).T
    ones = np.ones(2 * len(start), dtype=np.int32)
    both = (np.concatenate([start, end]), np.concatenate([end, start]))
    first = coo_array((ones, both), shape=(n, n)).tocsr()
    pairs = (first + first @ (diags_array(smooth.astype(np.int32), dtype=np.int32) @ first)).tocoo()
    i, j = pairs.coords
    joined = (i != j) & (pairs.data > 0)
    return i[joined], j[joined]


def _tangents(normals):
    """Two unit vectors that complete each unit normal to an orthonormal frame."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    t1 = np.cross(normals, axis)
    length = np.linalg.norm(t1, axis=1, keepdims=True)
    t1 /= np.where(length > 0, length, 1.0)
    return t1, np.cross(normals, t1)

"""Curved triangles as many small flat ones, fine enough for the eye."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..mesh import SurfaceMesh
from ..reference import lagrange_basis, lagrange_gradients


class FineSurface(NamedTuple):
    """A surface as it is drawn."""

    points: Float[np.ndarray, "points 3"]
    normals: Float[np.ndarray, "points 3"]
    triangles: Int[np.ndarray, "triangles 3"]
    edges: Int[np.ndarray, "edges along"]
    """Points along every edge of the mesh."""
    values: Float[np.ndarray, " points"] | None
    """The field at the points."""
    contour: Float[np.ndarray, "segments 2 3"] = np.zeros((0, 2, 3))
    """Ends of the segments of a line on which the field has one value."""


def _lattice(s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Barycentric integers of the points i + j <= s, the small triangles, the three sides."""
    number, points = {}, []
    for j in range(s + 1):
        for i in range(s + 1 - j):
            number[i, j] = len(points)
            points.append((s - i - j, i, j))
    up = [((i, j), (i + 1, j), (i, j + 1)) for i, j in number if i + j < s]
    down = [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in number if i + j < s - 1]
    triangles = np.array([[number[corner] for corner in triangle] for triangle in up + down])
    sides = [
        [number[i, 0] for i in range(s + 1)],
        [number[s - j, j] for j in range(s + 1)],
        [number[0, s - j] for j in range(s + 1)],
    ]
    return np.array(points), triangles, np.array(sides)


def _shared_points(corners: np.ndarray, barycentric: np.ndarray):
    """One number per point of the lattice on all cells, equal where neighbours meet.

    A point is known by the corners it leans on and by how much, whatever the triangle.
    """
    weights = np.broadcast_to(barycentric, (len(corners), *barycentric.shape))
    who = np.where(weights > 0, corners[:, None, :], -1)
    order = np.argsort(who, axis=-1)
    key = np.concatenate([np.take_along_axis(a, order, axis=-1) for a in (who, weights)], axis=-1)
    _, first, number = np.unique(key.reshape(-1, 6), axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(weights.shape[:2])


def with_contour(surface: FineSurface, level: float) -> FineSurface:
    """The same with the line on which the field is `level`, triangle by triangle."""
    if surface.values is None:
        return surface
    above = surface.values[surface.triangles] > level
    cut = above.any(axis=1) & ~above.all(axis=1)
    triangles, above = surface.triangles[cut], above[cut]
    # The corner that is alone on its side, and the two others: the line crosses both edges there.
    alone = np.argmax(above == (above.sum(axis=1, keepdims=True) == 1), axis=1)
    rows = np.arange(len(triangles))
    ends = []
    for turn in (1, 2):
        a, b = triangles[rows, alone], triangles[rows, (alone + turn) % 3]
        u, v = surface.values[a], surface.values[b]
        s = ((level - u) / (v - u))[:, None]
        ends.append((1 - s) * surface.points[a] + s * surface.points[b])
    return surface._replace(contour=np.stack(ends, axis=1))


def subdivide(
    mesh: SurfaceMesh,
    x: Float[np.ndarray, "nodes 3"],
    field: Float[np.ndarray, " nodes"] | None = None,
    most_triangles: int = 150_000,
) -> FineSurface:
    """Every cell cut into s² flat triangles through points of the curved cell itself.

    Normals are those of the curved cells, averaged where cells meet. Degree 1 stays as it is.
    """
    k = mesh.degree
    cells = np.asarray(mesh.cells)
    finest = int(np.sqrt(most_triangles / len(cells)))
    s = 1 if k == 1 else min(max(finest, 2), 10)
    barycentric, local_triangles, sides = _lattice(s)
    first, number = _shared_points(cells[:, :3], barycentric)
    xi = barycentric[:, 1:] / s
    phi, slopes = lagrange_basis(k, xi), lagrange_gradients(k, xi)
    jacobian = np.einsum("pjd,cjk->cpkd", slopes, x[cells])
    cross = np.cross(jacobian[..., 0], jacobian[..., 1])
    normals = np.zeros((len(first), 3))
    np.add.at(normals, number.ravel(), cross.reshape(-1, 3))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    edges = number[:, sides].reshape(-1, s + 1)
    values = None if field is None else (field[cells] @ phi.T).ravel()[first]
    return FineSurface(
        points=np.einsum("pj,cjk->cpk", phi, x[cells]).reshape(-1, 3)[first],
        normals=normals / np.where(length > 0, length, 1.0),
        triangles=number[:, local_triangles].reshape(-1, 3),
        edges=edges[edges[:, 0] < edges[:, -1]],
        values=values,
    )

r"""Conformal map of a closed triangle mesh of genus 0 to the unit sphere.

??? cite "Reference"
    Kazhdan, Solomon, Ben-Chen (2012), *Comput. Graph. Forum* 31, 1745–1754 (conformalised mean
    curvature flow); Baden, Crane, Kazhdan (2018), *Comput. Graph. Forum* 37, 129–139 (centring by
    Möbius transformations).
"""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

# Implicit steps in units of the square of the radius, until nothing moves by more than this part.
STEP, MOST_STEPS, SETTLED = 0.05, 400, 1e-3
MOST_CENTRINGS, CENTRED = 500, 1e-10
# Areas below this part of the mean count as this much: a collapsed triangle has no angles.
LEAST_AREA = 1e-6

Points = Float[np.ndarray, "vertices 3"]
Faces = Int[np.ndarray, "faces 3"]


def conformal_sphere(x: Points, faces: Faces) -> Points:
    r"""Points of the unit sphere for the vertices, by a map that keeps angles.

    Implicit steps $(M_t + \tau L_0)\,x_{t+1} = M_t\,x_t$ with the mass matrix $M_t$ of the moving
    surface and the stiffness matrix $L_0$ of the first one take a surface of genus 0 to the sphere,
    star-shaped or not. A Möbius transformation moves the centroid of the surface's area on the
    sphere to the centre, so that no part of it is crowded more than it has to be. The sphere is
    turned so that its points lie in the directions of the surface's own as nearly as they can.

    **Raises:** `ValueError` where triangles of the result are turned over: the mesh has handles,
    crosses itself, or has needles that no angle tells.
    """
    L, areas = stiffness(x, faces), vertex_areas(x, faces)
    y = _sphere(x, faces, L)
    y = _turned(_centred(y, areas), x, areas)
    inverted = int(np.count_nonzero(_volumes(y, faces) <= 0))
    if inverted:
        raise ValueError(
            f"the conformal map to the sphere turns {inverted} of {len(faces)} triangles over. It "
            "is for closed surfaces without handles that do not cross themselves; repair the mesh, "
            "or take its needles out."
        )
    return y


def _sphere(x: Points, faces: Faces, L) -> Points:
    y = _unit(x, faces)
    for _ in range(MOST_STEPS):
        m = 4 * np.pi * vertex_areas(y, faces) / np.sum(vertex_areas(y, faces))
        # Where a vertex has no area left the stiffness holds it in its place.
        moved = _unit(splu((sp.diags(m) + STEP * L).tocsc()).solve(m[:, None] * y), faces)
        change, y = np.max(np.linalg.norm(moved - y, axis=1)), moved
        if change < SETTLED:
            break
    return y / np.linalg.norm(y, axis=1, keepdims=True)


def _unit(y: Points, faces: Faces) -> Points:
    """Centred, with the area of the unit sphere."""
    m = vertex_areas(y, faces)
    return (y - m @ y / m.sum()) / np.sqrt(m.sum() / (4 * np.pi))


def _centred(y: Points, areas: Float[np.ndarray, " vertices"]) -> Points:
    """Inversions $y -> (1 - |c|^2)(y - c)/|y - c|^2 - c$ until the centroid c is the centre."""
    for _ in range(MOST_CENTRINGS):
        c = areas @ y / areas.sum()
        if np.linalg.norm(c) < CENTRED:
            break
        c = 0.7 * c
        d = y - c
        y = (1 - c @ c) * d / np.sum(d * d, axis=1, keepdims=True) - c
        y = y / np.linalg.norm(y, axis=1, keepdims=True)
    return y


def _turned(y: Points, x: Points, areas: Float[np.ndarray, " vertices"]) -> Points:
    """Rotated so that x is nearest to a symmetric positive matrix times y, and not mirrored."""
    x = x - areas @ x / areas.sum()
    U, _, Vt = np.linalg.svd((areas[:, None] * x).T @ y)
    U[:, -1] *= np.sign(np.linalg.det(U @ Vt))
    return y @ (U @ Vt).T


def stiffness(x: Points, faces: Faces):
    """Cotangent weights: the stiffness matrix of linear elements."""
    area = np.linalg.norm(_cross(x, faces), axis=1)
    area = np.maximum(area, LEAST_AREA * area.mean())
    rows, columns, values = [], [], []
    for k in range(3):
        i, j, o = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3], faces[:, k]
        w = 0.5 * np.sum((x[i] - x[o]) * (x[j] - x[o]), axis=1) / area
        rows += [i, j, i, j]
        columns += [j, i, i, j]
        values += [-w, -w, w, w]
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.csc_matrix(entries, shape=(len(x), len(x)))


def vertex_areas(x: Points, faces: Faces) -> Float[np.ndarray, " vertices"]:
    """A third of the triangles around each vertex."""
    area = 0.5 * np.linalg.norm(_cross(x, faces), axis=1)
    return np.bincount(faces.reshape(-1), np.repeat(area / 3, 3), len(x))


def _cross(x: Points, faces: Faces) -> Float[np.ndarray, "faces 3"]:
    a, b, c = (x[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _volumes(y: Points, faces: Faces) -> Float[np.ndarray, " faces"]:
    a, b, c = (y[faces[:, k]] for k in range(3))
    return np.sum(a * np.cross(b, c), axis=1)

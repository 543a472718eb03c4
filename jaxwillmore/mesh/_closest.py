"""Closest points on a curved surface: NumPy, on the host, outside of every derivative."""

import functools as ft
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from ..reference import lagrange_basis, lagrange_gradients, n_local_nodes

CANDIDATES, MOST_PAIRS = 8, 500_000
# Flat pieces are split until none is longer than so many of its widths, or radii of the others.
SLENDER, LARGE, MOST_SPLITS = 6.0, 4.0, 9
NEWTON_STEPS, CONVERGED = 8, 1e-10
# Step of differences of polynomial gradients; exact up to degree 3.
STEP = 1e-2
AT_EDGE = 1e-9
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


class Feet(NamedTuple):
    """Closest points, one for every query.

    **Attributes:**

    - `cell`, `xi`: where they are; NaN on surfaces that are not finite.
    - `freedom`: projection onto the directions of reference coordinates in which a foot is free to
      move: both inside of a cell, one on an edge, none at a corner.
    """

    cell: Int[np.ndarray, " points"]
    xi: Float[np.ndarray, "points 2"]
    freedom: Float[np.ndarray, "points 2 2"]


def closest(
    cells: Int[np.ndarray, "cells local"],
    nodes: Float[np.ndarray, "nodes 3"],
    queries: Float[np.ndarray, "points 3"],
) -> tuple[Int[np.ndarray, " points"], Float[np.ndarray, "points local 3"]]:
    """The cell that holds the point nearest to every query, and the tabulated basis there.

    Every cell is cut into flat pieces; the nearest of them give the start of Newton's method on the
    curved cell. The search looks at more pieces until no other one can be nearer, by the distance
    of its centre and its radius: needles hide nothing. `basis[p, j]` holds the value and the two
    reference derivatives of shape function j.

    *Limits:* where a normal of the surface has a kink, at edges of elements, the nearest point may
    sit in the kink; the line to it is then not exactly normal to the cell.
    """
    found = feet(cells, nodes, queries)
    degree = _degree(np.shape(cells)[1])
    value, slope = lagrange_basis(degree, found.xi), lagrange_gradients(degree, found.xi)
    return found.cell, np.concatenate([value[..., None], slope], -1)


def feet(
    cells: Int[np.ndarray, "cells local"],
    nodes: Float[np.ndarray, "nodes 3"],
    queries: Float[np.ndarray, "points 3"],
) -> Feet:
    """What `closest` finds, in reference coordinates."""
    return Search(cells, nodes).feet(queries)


class Search:
    """A surface in which many nearest points are looked for: prepared once, at rest."""

    def __init__(self, cells: Int[np.ndarray, "cells local"], nodes: Float[np.ndarray, "nodes 3"]):
        self._degree = _degree(np.shape(cells)[1])
        self._local = np.asarray(nodes)[np.asarray(cells)]
        self._is_finite = bool(np.all(np.isfinite(self._local)))
        if not self._is_finite:
            return
        xi, pieces = _pieces(self._degree)
        points = np.einsum("qj,tjd->tqd", lagrange_basis(self._degree, xi), self._local)
        self._corners = points[:, pieces].reshape(-1, 3, 3)
        centres, self._radius, self._owner = _balls(self._corners)
        self._tree, self._count = KDTree(centres), len(centres)
        self._sagitta = _sagitta(self._degree, self._local)

    def feet(self, queries: Float[np.ndarray, "points 3"]) -> Feet:
        """The nearest points."""
        queries, degree, local = np.asarray(queries), self._degree, self._local
        if not (self._is_finite and np.all(np.isfinite(queries))):
            # Whoever asks for a distance to such a surface gets one that is not finite.
            n = len(queries)
            return Feet(np.zeros(n, np.int32), np.full((n, 2), np.nan), np.zeros((n, 2, 2)))
        xi, pieces = _pieces(degree)
        query, piece, weights = self._nearest_pieces(queries, len(pieces))
        cell, piece = np.divmod(piece, len(pieces))
        start = np.einsum("pv,pvi->pi", weights, xi[pieces][piece])
        at = _polished(degree, local[cell][:, None], queries[query][:, None], start[:, None])[:, 0]
        foot = np.einsum("pj,pjd->pd", lagrange_basis(degree, at), local[cell])
        order = np.lexsort((np.sum((queries[query] - foot) ** 2, axis=1), query))
        winner = order[np.searchsorted(query[order], np.arange(len(queries)))]
        cell, at = cell[winner], at[winner]
        return Feet(cell.astype(np.int32), at, _freedom(at))

    def _nearest_pieces(self, queries, per_cell: int):
        """Pairs of a query and a flat piece on whose cell the nearest point may be, and where.

        First among the pieces with the nearest centres; then, where one that was not looked at may
        be as near, among all whose balls reach as far.

        - `per_cell`: so many pieces, one after the other, are those of a cell.
        """
        corners, margin = self._corners, 2 * self._sagitta
        count = min(CANDIDATES, self._count)
        far, ball = (a.reshape(len(queries), count) for a in self._tree.query(queries, count))
        query = np.repeat(np.arange(len(queries)), count)
        piece = self._owner[ball.reshape(-1)]
        found, nearest = _near(corners, per_cell, queries, query, piece, margin)
        reach = nearest + self._radius + margin
        unsure = (far[:, -1] < reach) & (count < self._count)
        if not np.any(unsure):
            return found
        (left,) = np.nonzero(unsure)
        number = self._tree.query_ball_point(queries[left], reach[left], return_length=True)
        parts = [tuple(a[~unsure[found[0]]] for a in found)]
        # Far from a fine surface all of it may be about as near: in turns, for the memory.
        for some in np.array_split(left, int(np.sum(number)) // MOST_PAIRS + 1):
            inside = self._tree.query_ball_point(queries[some], reach[some])
            query = np.repeat(some, [len(balls) for balls in inside])
            piece = self._owner[np.concatenate(inside).astype(int)]
            parts.append(_near(corners, per_cell, queries, query, piece, margin)[0])
        return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def _near(corners, per_cell: int, queries, query, piece, margin: float):
    """Of pairs of a query and a piece, which may be met often, those of the nearest cells.

    **Returns:** query, piece and weights of every cell that is farther than the nearest one by
    `margin` at most; and the distance of the nearest one for every query, infinite without pairs.
    """
    query, piece = np.divmod(np.unique(query * len(corners) + piece), len(corners))
    weights, distance = _on_triangles(queries[query], corners[piece])
    nearest = np.full(len(queries), np.inf)
    np.minimum.at(nearest, query, distance)
    # The nearest piece of each cell.
    order = np.lexsort((distance, piece // per_cell, query))
    cell = (query * len(corners) + piece // per_cell)[order]
    new = np.concatenate([[True], np.diff(cell) != 0])
    order = order[new]
    order = order[distance[order] <= nearest[query[order]] * (1 + 1e-12) + margin]
    return (query[order], piece[order], weights[order]), nearest


def _balls(corners):
    """Centres of balls that cover the pieces, the largest radius, and the piece of every ball."""
    owner = np.arange(len(corners))
    for _ in range(MOST_SPLITS):
        edges = np.roll(corners, -1, axis=1) - corners
        length = np.linalg.norm(edges, axis=2)
        longest = np.max(length, axis=1)
        width = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / longest.clip(1e-300)
        split = (longest > SLENDER * width) | (longest > LARGE * np.median(longest))
        split &= longest > 1e-2 * np.median(longest)
        if not np.any(split):
            break
        first = np.argmax(length[split], axis=1)
        a, b, c = (corners[split, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        corners = np.concatenate([corners[~split], *halves])
        owner = np.concatenate([owner[~split], owner[split], owner[split]])
    centres = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centres[:, None], axis=2).max()
    return centres, float(radius), owner


def _sagitta(degree: int, local) -> float:
    """How far the curved cells are from their flat pieces, about."""
    if degree == 1:
        return 0.0
    ends = np.stack([local[:, k] + local[:, (k + 1) % 3] for k in range(3)], axis=1) / 2
    halfway = np.array([[0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
    there = np.einsum("qj,tjd->tqd", lagrange_basis(degree, halfway), local)
    return float(np.max(np.linalg.norm(there - ends, axis=2))) / (2 * degree) ** 2


def _freedom(xi: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2 2"]:
    at_edge = np.concatenate([1 - xi.sum(axis=1, keepdims=True), xi], axis=1) < AT_EDGE
    free = np.broadcast_to(np.eye(2), (len(xi), 2, 2)).copy()
    for k in range(3):
        e = CORNERS[(k + 2) % 3] - CORNERS[(k + 1) % 3]
        free[at_edge[:, k]] = np.outer(e, e) / (e @ e)
    free[np.sum(at_edge, axis=1) > 1] = 0.0
    return free


def _degree(local: int) -> int:
    return next(k for k in (1, 2, 3, 4) if n_local_nodes(k) == local)


@ft.cache
def _pieces(degree: int) -> tuple[np.ndarray, np.ndarray]:
    return lattice(1 if degree == 1 else 2 * degree)


def lattice(n: int) -> tuple[Float[np.ndarray, "points 2"], Int[np.ndarray, "pieces 3"]]:
    """Points of the reference triangle, n to an edge, and the n² flat pieces between them."""
    number = {(i, j): k for k, (i, j) in enumerate(_grid(n))}
    xi = np.array(_grid(n), float) / n
    up = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in _grid(n - 1)]
    down = [
        (number[i + 1, j], number[i + 1, j + 1], number[i, j + 1])
        for i, j in (_grid(n - 2) if n > 1 else [])
    ]
    return xi, np.array(up + down)


def _grid(n: int) -> list[tuple[int, int]]:
    return [(i, j) for j in range(n + 1) for i in range(n + 1 - j)]


def _on_triangles(p, corners):
    """Barycentric coordinates of the point of a flat triangle nearest to p, and the distance."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    inside = _in_plane(p - a, b - a, c - a)
    choices = [inside]
    for start, end in ((0, 1), (1, 2), (2, 0)):
        s, e = corners[..., start, :], corners[..., end, :]
        length2 = np.maximum(np.sum((e - s) ** 2, axis=-1), 1e-300)
        t = np.clip(np.sum((p - s) * (e - s), axis=-1) / length2, 0.0, 1.0)
        weights = np.zeros(inside.shape)
        weights[..., start], weights[..., end] = 1 - t, t
        choices.append(weights)
    distances = []
    for weights in choices:
        gap = np.linalg.norm(p - np.einsum("...v,...vd->...d", weights, corners), axis=-1)
        distances.append(np.where(np.all(weights >= 0, axis=-1), gap, np.inf))
    which = np.argmin(np.stack(distances), axis=0)
    weights = np.take_along_axis(np.stack(choices), which[None, ..., None], axis=0)[0]
    return weights, np.take_along_axis(np.stack(distances), which[None], axis=0)[0]


def _in_plane(p, u, v):
    uu, uv, vv = (np.sum(x * y, axis=-1) for x, y in ((u, u), (u, v), (v, v)))
    pu, pv = np.sum(p * u, axis=-1), np.sum(p * v, axis=-1)
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * pu - uv * pv) / det, (uu * pv - uv * pu) / det
    return np.stack([1 - s - t, s, t], axis=-1)


def _polished(degree: int, local, p, xi):
    """Newton's method for the nearest point on a curved cell, kept inside the cell."""
    if degree == 1:
        return xi
    for _ in range(NEWTON_STEPS):
        slope, hessian = _quadratic(degree, local, p, xi)
        before, xi = xi, _inside(xi + np.linalg.solve(hessian, slope[..., None])[..., 0])
        if np.max(np.abs(xi - before)) < CONVERGED:
            break
    weights = np.concatenate([1 - xi.sum(axis=-1, keepdims=True), xi], axis=-1)
    lost = np.argmin(weights, axis=-1)
    stuck = np.nonzero(np.min(weights, axis=-1) < AT_EDGE)
    if len(stuck[0]):
        # The clipped step above ends on the edge, but not at the nearest point of it.
        p = np.broadcast_to(p, local.shape[:2] + (3,))
        one = tuple(a[stuck][:, None] for a in (local, p, xi, lost))
        xi[stuck] = _along_edge(degree, *one)[:, 0]
    return xi


def _along_edge(degree: int, local, p, xi, lost):
    """The same on the edge where barycentric coordinate `lost` vanishes."""
    start, end = CORNERS[(lost + 1) % 3], CORNERS[(lost + 2) % 3]
    along = end - start
    t = np.sum((xi - start) * along, axis=-1) / np.sum(along**2, axis=-1)
    for _ in range(NEWTON_STEPS):
        slope, hessian = _quadratic(degree, local, p, start + t[..., None] * along)
        bend = np.einsum("pci,pcij,pcj->pc", along, hessian, along)
        before, t = t, np.clip(t + np.sum(slope * along, axis=-1) / bend, 0.0, 1.0)
        if np.max(np.abs(t - before)) < CONVERGED:
            break
    return start + t[..., None] * along


def _quadratic(degree: int, local, p, xi):
    """Downhill slope and a positive Hessian of half the squared distance, by `xi`."""
    gap = p - np.einsum("pcj,pcjd->pcd", lagrange_basis(degree, xi), local)
    J = np.einsum("pcji,pcjd->pcid", lagrange_gradients(degree, xi), local)
    metric = np.einsum("pcid,pckd->pcik", J, J)
    bent = np.empty_like(metric)
    for k in range(2):
        e = STEP * np.eye(2)[k]
        second = lagrange_gradients(degree, xi + e) - lagrange_gradients(degree, xi - e)
        bent[..., k] = np.einsum("pcji,pcjd,pcd->pci", second / (2 * STEP), local, gap)
    hessian = metric - bent
    # Far away it may be indefinite; the metric alone always descends.
    convex = (np.linalg.det(hessian) > 0) & (np.trace(hessian, axis1=-2, axis2=-1) > 0)
    hessian = np.where(convex[..., None, None], hessian, metric)
    return np.einsum("pcid,pcd->pci", J, gap), hessian


def _inside(xi):
    """The nearest barycentric coordinates without negative entries, rescaled."""
    weights = np.concatenate([1 - xi.sum(axis=-1, keepdims=True), xi], axis=-1)
    weights = np.maximum(weights, 0.0)
    return (weights / weights.sum(axis=-1, keepdims=True))[..., 1:]

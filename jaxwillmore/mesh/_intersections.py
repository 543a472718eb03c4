"""Do triangles of a surface pierce each other; is one closed surface inside another."""

import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from ._adjacency import Triangles
from ._surface_mesh import SurfaceMesh

_CHUNK = 200_000  # pairs tested at once, which keeps the work arrays below 100 MB


def piercing_faces(
    triangles: Triangles, x: Float[np.ndarray, "vertices 3"]
) -> Int[np.ndarray, " piercing"]:
    """Triangles with an edge through, or pierced by an edge of, one they share no vertex with.

    **Limits:** triangles that overlap in a plane, or that share a vertex, are not compared.
    """
    corners = x[triangles]
    found = np.zeros(len(triangles), dtype=bool)
    low, high = corners.min(axis=1), corners.max(axis=1)
    for one, other in _near_pairs(corners):
        apart = np.any((low[one] > high[other]) | (low[other] > high[one]), axis=1)
        one, other = one[~apart], other[~apart]
        shared = np.any(triangles[one][:, :, None] == triangles[other][:, None, :], axis=(1, 2))
        one, other = one[~shared], other[~shared]
        hit = _edges_pierce(corners[one], corners[other])
        hit |= _edges_pierce(corners[other], corners[one])
        found[one[hit]] = True
        found[other[hit]] = True
    return np.flatnonzero(found)


def self_intersections(mesh: SurfaceMesh, x: Float[Array | np.ndarray, "nodes 3"]) -> int:
    """How many flat triangles between the vertices pierce another one, or are pierced."""
    vertices = np.asarray(x, dtype=np.float64)[: mesh.n_vertices]
    return len(piercing_faces(np.asarray(mesh.triangles), vertices))


def _near_pairs(corners):
    """Pairs of triangles whose circumscribed balls about the centroids meet, in chunks.

    Triangles are grouped by size, in octaves, so that one large triangle does not make all small
    ones look far.
    """
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    octave = np.floor(np.log2(radius / radius.max())).astype(int)
    groups = [np.flatnonzero(octave == o) for o in np.unique(octave)]
    trees = [KDTree(centre[group]) for group in groups]
    for a, small in enumerate(groups):
        for b in range(a, len(groups)):
            large = groups[b]
            for part in np.array_split(small, len(small) // 4000 + 1):
                near = trees[b].query_ball_point(centre[part], radius[part] + radius[large].max())
                counts = np.array([len(n) for n in near])
                one = np.repeat(part, counts)
                other = large[np.concatenate([np.asarray(n, dtype=int) for n in near])]
                if a == b:
                    one, other = one[one < other], other[one < other]
                for start in range(0, len(one), _CHUNK):
                    yield one[start : start + _CHUNK], other[start : start + _CHUNK]


def _edges_pierce(edges_of, target) -> Bool[np.ndarray, " pairs"]:
    """Whether an edge of the first triangle passes through the inside of the second one."""
    a, b, c = target[:, 0], target[:, 1], target[:, 2]
    normal = np.cross(b - a, c - a)
    height = np.einsum("pcd,pd->pc", edges_of - a[:, None], normal)
    result = np.zeros(len(target), dtype=bool)
    for e in range(3):
        crossing = np.flatnonzero(height[:, e] * height[:, (e + 1) % 3] < 0)
        start, end = edges_of[crossing, e], edges_of[crossing, (e + 1) % 3]
        line = end - start
        sides = [
            np.einsum("pd,pd->p", line, np.cross(p[crossing] - start, q[crossing] - start))
            for p, q in ((a, b), (b, c), (c, a))
        ]
        # Within rounding of the boundary counts as inside, or an edge through an edge is missed.
        size = np.linalg.norm(line, axis=1) * np.linalg.norm(normal[crossing], axis=1)
        inside = np.all(np.array(sides) >= -1e-12 * size, axis=0)
        inside |= np.all(np.array(sides) <= 1e-12 * size, axis=0)
        result[crossing[inside]] = True
    return result


def winding_number(point: Float[np.ndarray, "3"], corners: Float[np.ndarray, "cells 3 3"]) -> float:
    """How often a closed surface wraps around a point: ±1 inside, 0 outside.

    ??? cite "Reference"
        van Oosterom, Strackee (1983), *IEEE Trans. Biomed. Eng.* 30, 125–126.
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(p, axis=1) for p in (a, b, c))
    above = np.sum(a * np.cross(b, c), axis=1)
    below = la * lb * lc
    below += np.sum(a * b, axis=1) * lc + np.sum(b * c, axis=1) * la + np.sum(c * a, axis=1) * lb
    return float(np.sum(np.arctan2(above, below)) / (2 * np.pi))

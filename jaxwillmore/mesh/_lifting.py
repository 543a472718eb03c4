"""A smooth surface through the vertices of a triangulation: local polynomials, blended.

About every vertex the surface is a height over the plane of its normal: a polynomial of degree
four through the vertex, fitted to its neighbours and theirs. Over a triangle the polynomials of
its three corners are blended. Where the vertices lie on a smooth surface, so do the new points, up
to O(h⁵).

Edges that are bent sharply are creases: their ends have no polynomial, what lies between them
stays flat, and no fit looks beyond.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..reference import lagrange_basis
from ._adjacency import Edges, Triangles, edges
from ._stencils import powers, stencils

# An edge bent by more than this is a crease.
CREASE = math.radians(60)
# A fit is believed if its equations are that far from singular, and its coefficients, in units of
# the mean distance of the neighbours, are those of a surface that the mesh can show.
SMALLEST, STEEPEST, LARGEST = 1e-9, 1.0, 3.0
# Newton's steps for the height over a flat triangle; each gains a factor of about ten.
STEPS = 5


class Charts(NamedTuple):
    """A surface about each vertex as a polynomial height over a plane; zero on creases."""

    normals: Float[np.ndarray, "vertices 3"]
    tangents: tuple[Float[np.ndarray, "vertices 3"], Float[np.ndarray, "vertices 3"]]
    reach: Float[np.ndarray, " vertices"]
    coefficients: Float[np.ndarray, "vertices 14"]
    smooth: Bool[np.ndarray, " vertices"]

    def normal_distance(self, x, at, points) -> Float[np.ndarray, "..."]:
        """How far `points` are below the polynomials of the vertices `at`, along their normals."""
        away = points - x[at]
        u, v = (np.sum(away * t[at], axis=-1) / self.reach[at] for t in self.tangents)
        height = np.sum(self.coefficients[at] * powers(u, v), axis=-1) * self.reach[at]
        return height - np.sum(away * self.normals[at], axis=-1)


def charts(triangles: Triangles, x: Float[np.ndarray, "vertices 3"]) -> Charts:
    """The polynomials of all vertices: of degree four, of degree two where few neighbours tell."""
    sharp = np.zeros(len(x), bool)
    sharp[creases(triangles, x)] = True
    near = stencils(triangles, x, ~sharp)
    # The vertex itself is met; near neighbours count much more than far ones.
    weight = near.distance**-4.0
    columns = np.concatenate([powers(near.u, near.v), near.w[:, None]], axis=1)
    moments = near.moments(columns * weight[:, None])
    coefficients, smooth = np.zeros((len(x), 14)), np.zeros(len(x), bool)
    for count in (14, 5):
        found, good = _solved(moments[:, :count, :count], moments[:, :count, 14])
        new = good & ~smooth & ~sharp
        coefficients[new, :count], smooth = found[new], smooth | new
    return Charts(near.normals, near.tangents, near.reach, coefficients, smooth)


def _solved(matrix, right) -> tuple[np.ndarray, Bool[np.ndarray, " vertices"]]:
    """Coefficients, and where they are those of a surface."""
    spectrum = np.linalg.eigvalsh(matrix)
    good = spectrum[:, 0] > SMALLEST * spectrum[:, -1]
    found = np.zeros(right.shape)
    found[good] = np.linalg.solve(matrix[good], right[good][..., None])[..., 0]
    good &= np.sum(found[:, :2] ** 2, axis=1) < STEEPEST**2
    return found, good & (np.sum(np.abs(found), axis=1) < LARGEST)


def creases(
    triangles: Triangles, x: Float[np.ndarray, "vertices 3"], edge: Edges | None = None
) -> Int[np.ndarray, "creases 2"]:
    """Ends of the edges that are bent by more than 60°."""
    edge = edges(triangles) if edge is None else edge
    corners = x[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(size > 0, size, 1.0)
    total = np.zeros((len(edge.vertices), 3))
    np.add.at(total, edge.of_cell, normals[:, None])
    counts = np.bincount(edge.of_cell.ravel(), weights=np.repeat(size[:, 0] > 0, 3))
    bent = np.sum(total**2, axis=1) < 2 + 2 * math.cos(CREASE)
    return edge.vertices[bent & (counts == 2)]


def lift(
    triangles: Triangles,
    x: Float[np.ndarray, "vertices 3"],
    xi: Float[np.ndarray, "points 2"],
) -> Float[np.ndarray, "cells points 3"]:
    r"""Points over every triangle, at `xi` of the flat one, on the blend of its three polynomials.

    A point moves along the normal that is interpolated between the corners, until the distances to
    the three polynomials, with the weights $\lambda_i^2/\sum\lambda_j^2$ of its barycentric
    coordinates, sum to nothing. On an edge only its two ends count, so neighbours meet. Vertices
    without a polynomial hold a point where it is in the flat triangle.

    ??? cite "Reference"
        Cazals, Pouget (2005), *Computer Aided Geometric Design* 22, 121–146 (fits of polynomial
        heights and their order).
    """
    local = charts(triangles, x)
    basis = lagrange_basis(1, xi)
    flat = np.einsum("qc,tcd->tqd", basis, x[triangles])
    along = np.einsum("qc,tcd->tqd", basis, local.normals[triangles])
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    along = along / np.where(length > 0, length, 1.0)
    weights = basis**2 / np.sum(basis**2, axis=1, keepdims=True)
    height = np.zeros(flat.shape[:2])
    for _ in range(STEPS):
        change = np.zeros_like(height)
        points = flat + height[..., None] * along
        for corner in range(3):
            at = np.broadcast_to(triangles[:, corner, None], height.shape)
            slant = np.sum(along * local.normals[at], axis=-1)
            missing = local.normal_distance(x, at, points) / np.where(slant > 0.3, slant, 1.0)
            own = np.where(local.smooth[at] & (slant > 0.3), missing, -height)
            change += weights[:, corner] * own
        height += change
    return flat + height[..., None] * along

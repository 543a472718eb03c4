"""How good the triangles are."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Float

from ._surface_mesh import SurfaceMesh


@dataclass(frozen=True)
class Quality:
    """Sizes and shapes of the flat triangles between the vertices of a surface."""

    h_min: float
    """Smallest diameter h_T (longest edge) of a triangle."""
    h_max: float
    """Largest diameter h_T of a triangle."""
    chunkiness: float
    """Largest c_T = h_T / r_T, with r_T the radius of the inscribed circle; at best 2√3 = 3.46."""
    min_angle: float
    """Smallest angle, in degrees."""
    max_angle: float
    """Largest angle, in degrees."""
    area_ratio: float
    """Largest over smallest area of a triangle."""
    edge_ratio: float
    """Longest over shortest edge of the mesh."""


def quality(mesh: SurfaceMesh, x: Float[Array | np.ndarray, "nodes 3"]) -> Quality:
    """Sizes and angles of the triangles, from their vertices alone.

    A collapsed triangle has infinite chunkiness and area ratio. Runs on the host; not
    differentiable.
    """
    return quality_of(np.asarray(x, dtype=np.float64)[np.asarray(mesh.triangles)])


def quality_of(corners: Float[np.ndarray, "cells 3 3"]) -> Quality:
    """As `quality`, from the corners of the triangles."""
    lengths = edge_lengths(corners)
    area = areas(corners)
    angles = corner_angles(corners)
    h = lengths.max(axis=1)
    # The radius of the inscribed circle is twice the area over the perimeter.
    with np.errstate(divide="ignore", invalid="ignore"):
        chunkiness = np.where(area > 0, h * lengths.sum(axis=1) / (2 * area), np.inf)
        area_ratio = area.max() / area.min() if area.min() > 0 else np.inf
        edge_ratio = lengths.max() / lengths.min() if lengths.min() > 0 else np.inf
    return Quality(
        h_min=float(h.min()),
        h_max=float(h.max()),
        chunkiness=float(chunkiness.max()),
        min_angle=float(angles.min()),
        max_angle=float(angles.max()),
        area_ratio=float(area_ratio),
        edge_ratio=float(edge_ratio),
    )


def edge_lengths(corners: Float[np.ndarray, "cells 3 3"]) -> Float[np.ndarray, "cells 3"]:
    """Lengths of the edges 0→1, 1→2, 2→0 of flat triangles."""
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)


def areas(corners: Float[np.ndarray, "cells 3 3"]) -> Float[np.ndarray, " cells"]:
    """Areas of flat triangles."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * np.linalg.norm(np.cross(e1, e2), axis=-1)


def corner_angles(corners: Float[np.ndarray, "cells 3 3"]) -> Float[np.ndarray, "cells 3"]:
    """Angles of flat triangles in degrees; accurate for needles, unlike the arc cosine."""
    out = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(out, back), axis=-1)
    return np.degrees(np.arctan2(sine, np.sum(out * back, axis=-1)))

"""From where a surface is looked at: one direction and one scale for all surfaces of a picture."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Camera(NamedTuple):
    """A parallel projection; the rows of `axes` point right, up and towards the eye."""

    axes: Float[np.ndarray, "3 3"]
    half_height: float
    """Half of the height of a picture, in the unit of the coordinates."""

    def centre(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "3"]:
        """The point of space that comes to the middle of the picture of `points`."""
        seen = points @ self.axes.T
        return (0.5 * (seen.min(axis=0) + seen.max(axis=0))) @ self.axes


def _axes_from(direction: np.ndarray, up: np.ndarray) -> np.ndarray:
    towards = direction / np.linalg.norm(direction)
    right = np.cross(up, towards)
    if np.linalg.norm(right) < 1e-6 * np.linalg.norm(up):
        right = np.cross(np.roll(up, 1) + [0.0, 1e-3, 0.0], towards)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def _best_direction(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Look at the broad side from 34° above; round shapes are seen along fixed axes."""
    spread, frame = np.linalg.eigh(np.cov(points.T))
    short, middle, long = frame.T
    if spread[0] > 0.93 * spread[2]:
        short, middle, long = np.eye(3)[[2, 1, 0]]
    elif spread[1] > 0.93 * spread[2]:  # oblate: any axis of the disc serves
        middle, long = _fixed_pair(short)
    elif spread[0] > 0.93 * spread[1]:  # prolate
        middle, short = _fixed_pair(long)
    # signs that do not depend on the eigensolver
    short, middle, long = (v * np.sign(v[np.argmax(np.abs(v))]) for v in (short, middle, long))
    elevation, azimuth = np.deg2rad([34.0, 24.0])
    flat = np.cos(azimuth) * -middle + np.sin(azimuth) * long
    return np.cos(elevation) * flat + np.sin(elevation) * short, short


def _fixed_pair(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across `axis`, the second as near as possible to a coordinate axis."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    second = helper - (helper @ axis) * axis
    second = second / np.linalg.norm(second)
    return np.cross(axis, second), second


def camera_for(
    surfaces: Sequence[Float[np.ndarray, "_ 3"]], view: Sequence[float] | None = None
) -> Camera:
    """A camera for all surfaces; the first one decides the direction unless `view` does."""
    if view is None:
        direction, up = _best_direction(surfaces[0])
    else:
        direction, up = np.asarray(view, dtype=np.float64), np.array([0.0, 0.0, 1.0])
        if direction.shape != (3,) or not np.linalg.norm(direction) > 0:
            raise ValueError(f"`view` needs three numbers, not all zero; got {view}.")
    axes = _axes_from(direction, up)
    extents = [np.ptp(points @ axes.T, axis=0)[:2].max() for points in surfaces]
    return Camera(axes, 0.5 * 1.06 * max(extents))

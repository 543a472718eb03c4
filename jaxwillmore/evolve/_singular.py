r"""Where the mathematics of a flow ends: a surface that vanishes, pinches off or touches itself.

At a singular time T a flow looks like a similar one that shrinks. A law of order p, whose velocity
scales like $R^{1-p}$ (mean curvature flow: p = 2, Willmore flow and surface diffusion: p = 4), has
then a curvature $\max|A| \sim (T - t)^{-1/p}$, so that $\max|A|^{-p}$ falls linearly to zero at T.

??? cite "Reference"
    Huisken (1984, 1990), *J. Differential Geom.* 20, 237–266 and 31, 285–299 (mean curvature flow);
    Mayer, Simonett (2002), *Interfaces Free Bound.* 4, 89–109 (fourth order, numerically).
"""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ..flows import System
from ._solution import RESULTS

# A surface is a point when its radius is this part of what it was.
POINT = 1e-2
# Nodal normals this much shorter or longer than one belong to no surface that the mesh resolves.
NORMAL_LOST = 0.5
# How often a pinch has made the largest curvature of the start, and that of the sphere of its area.
STEEPER, SHARPER = 2.5, 3.0
# The singular time must be this near, as a part of the time that has passed.
NEAR = 0.1
# Of the largest curvature: records above it are on the way to the singularity.
ON_THE_WAY = 0.4

UNEXPLAINED = (
    *(RESULTS.step_too_small, RESULTS.not_finite, RESULTS.element_inverted),
    *(RESULTS.energy_rising, RESULTS.resolution_lost),
)


def has_vanished(records: Sequence[dict[str, float | int]]) -> bool:
    """Whether a surface is too small, compared with its start, to be anything but a point."""
    return records[-1]["area"] < POINT**2 * records[0]["area"]


def order_of(flow: System) -> float:
    """The order p of a law whose time scale is $R^p$; 0 where the size does not matter."""
    times = [float(flow.units(jnp.asarray(R)).time) for R in (10.0, 1.0)]
    return max(math.log10(times[0] / times[1]), 0.0)


def singular_time(
    order: float, records: Sequence[dict[str, float | int]], size: str = "max_curvature"
) -> float | None:
    r"""When $\max|A|^{-p}$ would be zero by a straight line through its last values.

    `None` where it does not fall, or too few steps tell.
    """
    if not order or not records or size not in records[0]:
        return None
    k = np.array([record[size] for record in records], float)
    t = np.array([record["t"] for record in records], float)
    below = np.flatnonzero(~(k > ON_THE_WAY * k[-1]))
    last = slice(below[-1] + 1 if len(below) else 0, None)
    if len(k[last]) < 4:
        return None
    # Relative to the last step: differences of nearly equal times keep their digits.
    y, s = (k[last] / k[-1]) ** -order, t[last] - t[-1]
    slope, at_end = np.polyfit(s, y, 1)
    return float(t[-1] - at_end / slope) if slope < 0 else None


def explained(
    result: RESULTS,
    flow: System,
    t0: float,
    records: Sequence[dict[str, float | int]],
) -> tuple[RESULTS, float | None]:
    """The reason why a run ended, and the singular time where that is the reason.

    - `result`: what ended the steps.
    - `t0`: when the run began.
    """
    vanished = bool(result == RESULTS.vanished)
    unexplained = any(bool(result == other) for other in UNEXPLAINED)
    if not records or not (vanished or unexplained):
        return result, None
    T = singular_time(order_of(flow), records)
    if vanished:
        return result, T
    if T is None or "max_curvature" not in records[-1]:
        return result, None
    k0, last = records[0]["max_curvature"], records[-1]
    k, R = last["max_curvature"], math.sqrt(last["area"] / (4 * math.pi))
    near = T - last["t"] < NEAR * (last["t"] - t0)
    sharp = k > STEEPER * k0 and k * R > SHARPER * math.sqrt(2)
    return (RESULTS.pinching, T) if near and sharp else (result, None)

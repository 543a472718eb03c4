"""How long a correction of the host's Newton iteration is, and how much of it is taken."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ._host_system import HostSystem
from ._newton import SMALLEST_DAMPING, TRUST


class Found(NamedTuple):
    """The vector after a correction, its residual, and whether that is acceptable."""

    y: np.ndarray
    f: np.ndarray
    damping: float
    tried: int
    accepted: bool


def relative_size(system: HostSystem, y: np.ndarray, d: np.ndarray) -> float:
    """The largest of the sizes of `d` in every field and global unknown.

    A size is relative to the largest value of the field in `y`, and to its typical size, which is
    one, if that is larger.
    """
    n = len(y) - system.n_globals
    largest, values = (np.abs(a[:n]).reshape(-1, system.n_fields).max(axis=0) for a in (d, y))
    sizes = [largest[c].max() / max(values[c].max(), 1.0) for c in system.spans]
    tails = np.abs(d[n:]) / np.maximum(np.abs(y[n:]), 1.0)
    return float(np.max([*sizes, *tails]))


def damped(
    residual: Callable, y: np.ndarray, f: np.ndarray, d: np.ndarray, size: float, mixed=None
) -> Found:
    """Subtract `mixed` if that serves; else `d`, halved until the residual falls.

    A correction of less than `TRUST` is taken as it is: the residual may be at rounding already.

    **Arguments:**

    - `f`, `size`: the residual at `y`, and the relative size of `d`.
    """
    before, tried, damping = np.linalg.norm(f), 0, 1.0
    steps = [d] if mixed is None else [mixed, d]
    while True:
        new_y = y - damping * steps[0]
        new_f = residual(new_y)
        tried += 1
        # A step so far astray that the square of its residual overflows is one too long.
        with np.errstate(over="ignore", invalid="ignore"):
            after = np.linalg.norm(new_f)
        falls = after <= (1 - 1e-4 * damping) * before or size * damping < TRUST
        accepted = bool(falls and np.isfinite(after))
        if accepted or (len(steps) == 1 and damping <= SMALLEST_DAMPING):
            return Found(new_y, new_f, damping, tried, accepted)
        if len(steps) == 2:
            steps.pop(0)
        else:
            damping *= 0.5

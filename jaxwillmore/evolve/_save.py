"""States at requested times, interpolated from the history of a multistep method."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ._bdf import extrapolation
from ._solution import State
from ._stepper import History, Stepper


def save_times(saveat: float | Sequence[float] | None, t0: float, t1: float) -> list[float]:
    """The times that `saveat` asks for, in order, without `t0` itself.

    **Raises:** `ValueError` for an interval that is not positive, and for times that do not
    increase or lie outside `[t0, t1]`.
    """
    if saveat is None:
        return []
    if np.ndim(saveat) == 0:
        interval = float(saveat)  # pyright: ignore[reportArgumentType]
        if not (math.isfinite(interval) and interval > 0):
            raise ValueError(f"`saveat` needs a positive interval or rising times; got {saveat}.")
        n = math.floor((t1 - t0) / interval * (1 + 1e-12))
        # The last one may miss t1 by rounding, on the far side.
        return [min(t0 + k * interval, t1) for k in range(1, n + 1)]
    times = [float(t) for t in np.asarray(saveat, float)]
    if not all(b > a for a, b in zip(times, times[1:], strict=False)):
        raise ValueError(f"The times of `saveat` must increase; got {times}.")
    if times and not (t0 <= times[0] and times[-1] <= t1):
        raise ValueError(f"The times of `saveat` must lie in [{t0}, {t1}]; got {times}.")
    return [t for t in times if t > t0]


class Saver:
    """Hands out the states at the requested times as the history passes them."""

    def __init__(self, times: list[float], order: int):
        self._order, self._times = order, list(times)

    def skip(self, t: float) -> None:
        """Forget the times up to `t`, whose states have been handed out."""
        while self._times and self._is_passed(t):
            self._times.pop(0)

    def _is_passed(self, newest: float) -> bool:
        return self._times[0] <= newest + 1e-12 * abs(newest)

    def passed(self, stepper: Stepper, history: History, known: int) -> list[State]:
        """States at the requested times up to the newest one; `known` rows of it are states."""
        newest, out = float(history.times[0]), []
        while self._times and self._is_passed(newest):
            out.append(self._at(stepper, history, known, self._times.pop(0)))
        return out

    def _at(self, stepper: Stepper, history: History, known: int, t: float) -> State:
        points = min(known, self._order + 1)
        # V and z of the initial state are not known: they come from the solved states only.
        solved = min(points, known - 1)
        weights = extrapolation(history.times[:points], jnp.asarray(t))
        x = jnp.tensordot(weights, history.x[:points], axes=1)
        evolving = jnp.tensordot(weights, history.U[:points], axes=1)
        weights = extrapolation(history.times[:solved], jnp.asarray(t))
        algebraic = jnp.tensordot(weights, history.U[:solved], axes=1)
        flow, mesh = stepper.problem.flow, stepper.problem.mesh
        mask = np.zeros(flow.layout.width, bool)
        for name in flow.evolving:
            mask[flow.layout.columns(name)] = True
        return State(t, x, stepper.fields(jnp.where(mask, evolving, algebraic)), mesh)

"""Step sizes: error control, rejections, graded starts of runs with a fixed step."""

import dataclasses
import math


@dataclasses.dataclass(frozen=True)
class Controller:
    """Chooses steps from the distance between the new nodes and their prediction.

    The estimate is the largest distance over `(q + 1)` times the extent of the surface; for BDF of
    order `q` it follows `rtol` over more than a decade.

    **Arguments:**

    - `rtol`: tolerance for the estimate.
    - `growth`: largest factor between steps. BDF2 is stable for ratios below 2.41, BDF3 below
      1.53, BDF4 below about 1.28.
    - `smallest`: steps below this end the run.
    - `energy_tolerance`: relative rise of the energy that is still accepted; rounding and the
      discretisation allow no exact energy law.
    """

    rtol: float
    growth: float = 2.0
    smallest: float = 0.0
    energy_tolerance: float = 1e-5

    def after_acceptance(
        self, dt: float, error: float, order: int, iterations: int, rise: float
    ) -> float:
        """The next step, after one with that error estimate and relative rise of the energy."""
        factor = 0.9 * (self.rtol / max(error, 1e-300)) ** (1 / max(order, 2))
        # A discrete equilibrium is not the minimiser of a discrete energy: near it the energy may
        # creep up, in proportion to the step. Keep that within what a step may do.
        if rise > 0:
            factor = min(factor, 0.9 * self.energy_tolerance / rise)
        # A solve that needed many iterations is close to failing; do not push it.
        largest = 1.0 if iterations >= 9 else self.growth
        return dt * min(largest, max(factor, 0.5))


def growth_limit(bdf_order: int) -> float:
    """Largest step ratio for which variable-step BDF stays stable."""
    return {1: 2.0, 2: 2.0, 3: 1.5, 4: 1.25, 5: 1.1}[bdf_order]


def graded_times(t0: float, t1: float, dt: float, bdf_order: int, time_scale: float) -> list[float]:
    """Times of a run with fixed step `dt`, with a start that keeps the order.

    The first step can only be of order 1. It is so short, `T (dt/T)^(q/2)`, that its error is of
    the size of dt^q; from there steps grow by the largest ratio for which BDF of order q is stable.
    A start of fewer, faster growing steps would divide the error of a short step by a long one.

    **Arguments:**

    - `time_scale`: the time T in which the solution changes by about its size.
    """
    times = [t0]
    step = dt * min(dt / time_scale, 1.0) ** max(bdf_order / 2 - 1, 0.0)
    while step < dt and times[-1] + step < t1:
        times.append(times[-1] + step)
        step *= growth_limit(bdf_order)
    n = max(1, math.ceil((t1 - times[-1]) / dt - 1e-9))
    start = times[-1]
    return times + [start + (t1 - start) * (i + 1) / n for i in range(n)]

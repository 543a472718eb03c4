r"""Time series: parameters of a flow from surfaces that were seen at known times."""

import time
from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._interrupts import catch_interrupts
from .._observers import asks_to_stop
from ..evolve import Stepper
from ..mesh import SurfaceMesh
from ..surface import area_radius
from ._conclusion import UNSEEN, concluded, start_of
from ._descend import Descent, Iterate, descend
from ._flow_fit import FlowFit
from ._flow_residuals import Build, FlowResiduals, Schedule, schedule
from ._parameters import AbstractRange, Positive, Unbounded
from ._results import RESULTS, message, name_of
from ._targets import Target, checked_surface, target

# Distance in R0 that counts as one against the damping of the descent.
RESOLUTION = 1e-2
# A schedule is good for parameters that differ by this much from those it was made with.
SAME_SCHEDULE = 0.02
MAX_STAGES = 6


def fit_flow(
    build: Build,
    mesh: SurfaceMesh,
    x0: Float[Array, "nodes 3"],
    times: Sequence[float],
    observations: Sequence[tuple[SurfaceMesh | np.ndarray, Float[Array | np.ndarray, "_ 3"]]],
    *,
    start: Mapping[str, float],
    ranges: Mapping[str, AbstractRange] | None = None,
    t0: float = 0.0,
    rtol: float = 1e-4,
    noise: float | None = None,
    tolerance: float = 1e-7,
    max_steps: int = 40,
    rank_tolerance: float = 1e-3,
    throw: bool = True,
    observer: Callable[[dict[str, float]], object] | None = None,
) -> FlowFit:
    r"""Fit parameters of a flow to surfaces seen at known times.

    A flow shows what a shape at rest does not: $b_b$ itself, through the rate at which the surface
    moves. The unit is that of the law, in which a force density moves the surface with the
    velocity of equal number (mobility 1); for another mobility the product is found.

    The time steps are chosen by an adaptive run at the start values and then held; between stages
    they are chosen again. Every observation falls on a step.

    **Arguments:**

    - `build`: a function from parameters by name to a flow. Use the same function object for fits
      that should share compiled code.
    - `mesh`, `x0`: the surface at `t0`, known exactly.
    - `times`, `observations`: increasing times after `t0`, and a closed surface for each.
    - `start`: first guess of every free parameter.
    - `ranges`: what values they may take; by default positive for names that end in `modulus`,
      else unbounded.
    - `rtol`: error of a time step, as in `evolve`; it bounds the accuracy of the parameters. On a
      red cell that becomes a sphere, with exact data, the default gives the modulus to 1e-4.
    - `noise`: standard deviation of independent normal errors of the points seen; left out, it is
      taken from the residuals.
    - `observer`: called with a row of numbers after every accepted step; `True` ends the fit, as in
      `evolve`.

    **Raises:** `ValueError` for times that do not increase and observations that are no closed
    surfaces of the genus of the start; `RuntimeError`.

    ```python
    build = lambda p: jw.flows.WillmoreFlow(p["bending_modulus"])
    fit = jw.fit.fit_flow(build, mesh, x0, times, seen, start={"bending_modulus": 1.0})
    ```
    """
    began = time.perf_counter()
    seen_times = _checked_times(t0, times, observations)
    mesh, x0 = checked_surface(mesh, x0)
    targets = tuple(_checked(mesh, m, x) for m, x in observations)
    chosen = {n: Positive() if n.endswith("modulus") else Unbounded() for n in start}
    chosen |= {} if ranges is None else dict(ranges)
    spread = tuple(chosen[name] for name in start)
    u = start_of(start, spread)
    values = {name: float(value) for name, value in start.items()}
    with catch_interrupts() as interrupted:
        steps = schedule(build, mesh, x0, values, seen_times, rtol)
        residuals = FlowResiduals(
            build,
            tuple(start),
            spread,
            Stepper(build(_arrays(values)), mesh, newton_tolerance=1e-11),
            mesh,
            x0,
            jnp.asarray(steps.times),
            jnp.asarray(np.cumsum(steps.counts)),
            tuple(t.observed for t in targets),
            area_radius(mesh, x0) * RESOLUTION * np.sqrt(sum(t.count for t in targets)),
        )
        fitter = _Fitter(residuals, steps, rtol, tolerance, max_steps, observer, interrupted)
        descent = fitter.run(u, values, seen_times)
    stats = {
        "steps": fitter.steps,
        "stages": fitter.stages,
        "time_steps": len(steps.times) - 1,
        "seconds": time.perf_counter() - began,
    }
    fit = _finished(fitter, descent, targets, noise, rank_tolerance, stats)
    if throw and not (fit.succeeded or bool(fit.result == RESULTS.stopped)):
        raise RuntimeError(f"No fit ({name_of(fit.result)}): {message(fit.result)}")
    return fit


def _checked_times(t0: float, times, observations) -> Float[np.ndarray, " observations_plus_1"]:
    """The time of the start and those of the observations."""
    seen = np.array([t0, *np.asarray(times, float)])
    if len(seen) == 1 or len(seen) != len(observations) + 1:
        raise ValueError(f"{len(seen) - 1} times for {len(observations)} observations.")
    if not (np.all(np.isfinite(seen)) and np.all(np.diff(seen) > 0)):
        raise ValueError(f"`times` must increase from t0 = {t0}; got {seen[1:].tolist()}.")
    return seen


def _checked(start: SurfaceMesh, mesh, x) -> Target:
    mesh, x = checked_surface(mesh, x)
    if mesh.genus != start.genus:
        raise ValueError(
            f"An observation has genus {mesh.genus} and the start {start.genus}; a flow does not "
            "change that. Check the files, and their order."
        )
    return target(mesh, x)


def _arrays(values: Mapping[str, float]) -> dict[str, Array]:
    return {name: jnp.asarray(value) for name, value in values.items()}


class _Fitter:
    """The loop over stages: a schedule, a descent on it, a new schedule."""

    def __init__(
        self,
        residuals: FlowResiduals,
        steps: Schedule,
        rtol,
        tolerance,
        max_steps,
        observer,
        interrupted,
    ):
        self.residuals, self.schedule, self.rtol = residuals, steps, rtol
        self.tolerance, self.max_steps = tolerance, max_steps
        self.observer, self.interrupted = observer, interrupted
        self.history: list[dict[str, float]] = []
        self.steps = self.stages = 0

    def run(self, u, values: dict[str, float], seen_times) -> Descent:
        """Descend until the parameters belong to their schedule."""
        if self.schedule.failed is not None:
            rows = sum(len(seen.points) for seen in self.residuals.observed)
            nothing = np.zeros(rows), np.zeros((rows, len(u)))
            return Descent(u, *nothing, 0.0, self.schedule.failed, 0, solved=False)
        while True:
            descent = descend(
                self.residuals,
                u,
                tolerance=self.tolerance,
                max_steps=self.max_steps - self.steps,
                observer=self._seen,
                interrupted=self.interrupted,
            )
            self.steps, self.stages, u = self.steps + descent.steps, self.stages + 1, descent.u
            new = {n: float(v) for n, v in self.residuals.values(u).items()}
            moved = max(abs(new[n] - values[n]) / max(abs(values[n]), 1e-300) for n in new)
            if not bool(descent.result == RESULTS.converged) or moved < SAME_SCHEDULE:
                return descent
            if self.stages >= MAX_STAGES:
                return descent
            values, r = new, self.residuals
            arguments = r.build, r.mesh, r.x0, values, seen_times, self.rtol
            self.schedule = schedule(*arguments, self.schedule.counts)
            if self.schedule.failed is not None:
                return descent._replace(result=self.schedule.failed)
            times = jnp.asarray(self.schedule.times)
            self.residuals = eqx.tree_at(lambda r: r.times, r, times)

    def _seen(self, iterate: Iterate) -> bool:
        row = {
            "step": float(len(self.history)),
            "rms": float(np.sqrt(2 * iterate.objective)) * RESOLUTION,
        }
        row |= {n: float(v) for n, v in self.residuals.values(iterate.u).items()}
        self.history.append(row)
        return self.observer is not None and asks_to_stop(self.observer(row))


def _finished(
    fitter: _Fitter, descent: Descent, targets: tuple[Target, ...], noise, rank_tolerance, stats
) -> FlowFit:
    residuals, u = fitter.residuals, descent.u
    lost = not fitter.history or not descent.solved
    end = concluded(
        residuals,
        descent,
        lost,
        UNSEEN / RESOLUTION,
        count=sum(t.count for t in targets),
        variance=None if noise is None else float((noise / residuals.unit) ** 2),
        rank_tolerance=rank_tolerance,
    )
    rms = float("nan") if lost else float(np.linalg.norm(end.residuals)) * RESOLUTION
    return FlowFit(
        end.parameters,
        end.identification,
        rms,
        residuals,
        u,
        end.jacobian,
        targets,
        tuple(fitter.history),
        end.result,
        stats,
    )

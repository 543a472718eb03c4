r"""Time series: parameters of a flow from surfaces that were seen at known times."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._interrupts import catch_interrupts
from ..evolve import Stepper, evolve, replay
from ..flows import AbstractFlow
from ..mesh import SurfaceMesh
from ..surface import area_radius
from ._descend import Aux, Descent, Iterate, descend
from ._distance import Surface, signed_distance
from ._identify import Identification
from ._parameters import AbstractRange, Positive, Unbounded
from ._results import RESULTS, message, name_of
from ._shape_residuals import NOWHERE, Observed, target
from ._statistics import laplace
from ._targets import checked_surface

# Distance in R0 that counts as one against the damping of the descent.
RESOLUTION = 1e-2
# A schedule is good for parameters that differ by this much from those it was made with.
SAME_SCHEDULE = 0.02
MAX_STAGES = 6

Build = Callable[[dict[str, Array]], AbstractFlow]


class FlowResiduals(eqx.Module):
    """Distances between a flow and the surfaces seen at some of its times.

    **Attributes:**

    - `build`: parameters by name to flow.
    - `names`, `ranges`: of the free parameters.
    - `stepper`, `mesh`, `x0`, `times`: what `replay` takes.
    - `seen_at`: numbers of the times at which there is an observation.
    - `observed`: one for each.
    - `unit`: distance that counts as one, times the square root of the number of points.
    """

    build: Build = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    ranges: tuple[AbstractRange, ...]
    stepper: Stepper
    mesh: SurfaceMesh
    x0: Float[Array, "nodes 3"]
    times: Float[Array, " times"]
    seen_at: Int[Array, " observations"]
    observed: tuple[Observed, ...]
    unit: Float[Array, ""]

    def values(self, u: Float[Array, " unknowns"]) -> dict[str, Array]:
        """Parameters by name."""
        return {
            n: r.value(u[k]) for k, (n, r) in enumerate(zip(self.names, self.ranges, strict=True))
        }

    def __call__(self, u: Float[Array, " unknowns"]) -> tuple[Float[Array, " rows"], Aux]:
        flow = self.build(self.values(u))
        run = replay(flow, self.mesh, self.x0, self.times, stepper=self.stepper)
        rows = []
        for k, seen in enumerate(self.observed):
            model = Surface(self.mesh.cells, run.x[self.seen_at[k]])
            rows.append(jnp.sqrt(seen.weights) * signed_distance(model, seen.points))
        r = jnp.concatenate(rows) / self.unit
        good = run.converged & jnp.all(jnp.isfinite(r))
        return jnp.where(good, r, NOWHERE), Aux(good, jnp.zeros(()))


@dataclasses.dataclass(frozen=True)
class FlowFit:
    """The end of a fit to a time series.

    **Attributes:**

    - `parameters`: values by name.
    - `identification`: their intervals, singular values and null directions.
    - `rms`: root mean square of the distances over the area radius of the start.
    - `residuals`, `u`: the problem on its last schedule, and its solution.
    - `history`, `result`, `stats`: accepted steps, why it ended, what it cost.
    """

    parameters: dict[str, float]
    identification: Identification
    rms: float
    residuals: FlowResiduals
    u: Float[Array, " unknowns"]
    history: tuple[dict[str, float], ...]
    result: RESULTS
    stats: dict[str, Any]

    @property
    def succeeded(self) -> bool:
        """Whether the distance is least at parameters that the data determine."""
        return bool(self.result == RESULTS.converged)


def fit_flow(
    build: Build,
    mesh: SurfaceMesh,
    x0: Float[Array, "nodes 3"],
    times: Sequence[float],
    observations: Sequence[tuple[SurfaceMesh | np.ndarray, Float[Array | np.ndarray, "nodes 3"]]],
    *,
    start: Mapping[str, float],
    ranges: Mapping[str, AbstractRange] | None = None,
    t0: float = 0.0,
    rtol: float = 1e-3,
    noise: float | None = None,
    tolerance: float = 1e-7,
    max_steps: int = 40,
    rank_tolerance: float = 1e-3,
    throw: bool = True,
    observer: Callable[[dict[str, float]], None] | None = None,
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
    - `rtol`: error of a time step, as in `evolve`; it bounds the accuracy of the parameters.
    - `noise`: standard deviation of independent normal errors of the points seen; left out, it is
      taken from the residuals.

    **Raises:** `ValueError` for times that do not increase and observations that are no closed
    surfaces; `RuntimeError`.

    ```python
    build = lambda p: jw.flows.WillmoreFlow(p["bending_modulus"])
    fit = jw.fit.fit_flow(build, mesh, x0, times, seen, start={"bending_modulus": 1.0})
    ```
    """
    began = time.perf_counter()
    seen_times = np.asarray(times, float)
    if len(seen_times) == 0 or len(seen_times) != len(observations):
        raise ValueError(f"{len(seen_times)} times for {len(observations)} observations.")
    if not (np.all(np.isfinite(seen_times)) and np.all(np.diff([t0, *seen_times]) > 0)):
        raise ValueError(f"`times` must increase from t0 = {t0}; got {seen_times.tolist()}.")
    if len(start) == 0:
        raise ValueError("`start` is empty; name at least one parameter.")
    mesh, x0 = checked_surface(mesh, x0)
    targets = [target(*checked_surface(m, x)) for m, x in observations]
    chosen = {n: Positive() if n.endswith("modulus") else Unbounded() for n in start}
    chosen |= {} if ranges is None else dict(ranges)
    names = tuple(start)
    spread = tuple(chosen[name] for name in names)
    u = jnp.asarray([r.unknown(float(start[n])) for n, r in zip(names, spread, strict=True)])
    values = {name: float(value) for name, value in start.items()}
    counts, grid = _schedule(build, mesh, x0, values, t0, seen_times, rtol, None)
    radius = float(area_radius(mesh, x0))
    count = sum(t.count for t in targets)
    residuals = FlowResiduals(
        build,
        names,
        spread,
        Stepper(build(_arrays(values)), mesh, newton_tolerance=1e-11),
        mesh,
        x0,
        jnp.asarray(grid),
        jnp.asarray(np.cumsum(counts)),
        tuple(t.observed for t in targets),
        jnp.asarray(radius * RESOLUTION * np.sqrt(count)),
    )
    history: list[dict[str, float]] = []

    def seen(iterate: Iterate) -> None:
        row = {
            "step": float(len(history)),
            "rms": float(np.sqrt(2 * iterate.objective)) * RESOLUTION,
        }
        row |= {n: float(v) for n, v in residuals.values(iterate.u).items()}
        history.append(row)
        if observer is not None:
            observer(row)

    steps, stages = 0, 0
    with catch_interrupts() as interrupted:
        while True:
            descent = descend(
                residuals,
                u,
                tolerance=tolerance,
                max_steps=max_steps - steps,
                observer=seen,
                interrupted=interrupted,
            )
            steps, stages, u = steps + descent.steps, stages + 1, descent.u
            new = {n: float(v) for n, v in residuals.values(u).items()}
            moved = max(abs(new[n] - values[n]) / max(abs(values[n]), 1e-300) for n in names)
            done = not bool(descent.result == RESULTS.converged) or moved < SAME_SCHEDULE
            if done or stages >= MAX_STAGES:
                break
            values = new
            _, grid = _schedule(build, mesh, x0, values, t0, seen_times, rtol, counts)
            residuals = eqx.tree_at(lambda r: r.times, residuals, jnp.asarray(grid))
    stats = {
        "steps": steps,
        "stages": stages,
        "time_steps": len(grid) - 1,
        "seconds": time.perf_counter() - began,
    }
    fit = _finished(residuals, descent, count, noise, rank_tolerance, tuple(history), stats)
    if throw and not fit.succeeded:
        raise RuntimeError(f"No fit ({name_of(fit.result)}): {message(fit.result)}")
    return fit


def _arrays(values: Mapping[str, float]) -> dict[str, Array]:
    return {name: jnp.asarray(value) for name, value in values.items()}


def _schedule(build: Build, mesh, x0, values, t0, times, rtol, counts):
    """Steps between the observations, and all times; spaced as an adaptive run spaces them.

    Given `counts` are kept, so that the compiled run is: only the spacing follows the new values.
    """
    flow = build(_arrays(values))
    run = evolve(flow, mesh, x0, t0=t0, t1=float(times[-1]), rtol=rtol)
    accepted = np.asarray(run.times)
    at = np.interp([t0, *times], accepted, np.arange(len(accepted)))
    if counts is None:
        # Two more per interval: steps that hit an observation are shorter than they might be.
        counts = [int(np.ceil(gap)) + 2 for gap in np.diff(at)]
    pieces = [np.linspace(at[k], at[k + 1], n + 1)[1:] for k, n in enumerate(counts)]
    grid = np.interp(np.concatenate([[0.0], *pieces]), np.arange(len(accepted)), accepted)
    grid[np.cumsum(counts)] = times
    return counts, grid


def _finished(
    residuals: FlowResiduals, descent: Descent, count, noise, rank_tolerance, history, stats
):
    u = descent.u
    result = RESULTS.stalled if descent.result is None else descent.result
    values = {n: float(v) for n, v in residuals.values(u).items()}
    r, J = descent.residuals, descent.jacobian
    if not descent.solved:
        r, J = np.zeros(len(r)), np.zeros(J.shape)
    slopes = [float(eqx.filter_grad(q.value)(u[k])) for k, q in enumerate(residuals.ranges)]
    found = laplace(
        r,
        J,
        residuals.names,
        np.array(list(values.values())),
        np.array(slopes),
        count=count,
        variance=None if noise is None else float((noise / residuals.unit) ** 2),
        rank_tolerance=rank_tolerance,
    )
    if bool(result == RESULTS.converged):
        if any(q.on_bound(v) for q, v in zip(residuals.ranges, values.values(), strict=True)):
            result = RESULTS.on_bound
        elif not all(found.identifiable.values()):
            result = RESULTS.not_identifiable
    rms = float(np.linalg.norm(descent.residuals)) * RESOLUTION
    return FlowFit(values, found, rms, residuals, u, history, result, stats)

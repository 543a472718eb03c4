"""Distances between a flow and the surfaces seen at known times, on a frozen schedule."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..evolve import RESULTS as ENDS, Stepper, Trajectory, evolve, replay
from ..flows import AbstractLaw, System
from ..mesh import SurfaceMesh
from ..surface import distance_to_cells
from ._conclusion import values_of
from ._descend import Aux
from ._parameters import AbstractRange
from ._results import RESULTS
from ._shape_residuals import NOWHERE
from ._targets import Observed

Build = Callable[[dict[str, Array]], System | AbstractLaw]


class FlowResiduals(eqx.Module):
    """Distances between a flow and the surfaces seen at some of its times.

    **Attributes:**

    - `build`: parameters by name to flow.
    - `labels`, `ranges`: of the free parameters.
    - `stepper`, `mesh`, `x0`, `times`: what `replay` takes.
    - `seen_at`: numbers of the times at which there is an observation.
    - `observed`: one for each.
    - `unit`: distance that counts as one, times the square root of the number of points.
    """

    build: Build = eqx.field(static=True)
    labels: tuple[str, ...] = eqx.field(static=True)
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
        return values_of(self, u)

    def run(self, u: Float[Array, " unknowns"]) -> Trajectory:
        """The flow on its schedule."""
        flow = self.build(self.values(u))
        return replay(flow, self.mesh, self.x0, self.times, stepper=self.stepper)

    def __call__(self, u: Float[Array, " unknowns"]) -> tuple[Float[Array, " rows"], Aux]:
        return self.compared(self.run(u))

    def compared(self, run: Trajectory) -> tuple[Float[Array, " rows"], Aux]:
        """The distances of a run from the observations."""
        rows = []
        for k, seen in enumerate(self.observed):
            d = distance_to_cells(self.mesh.cells, run.x[self.seen_at[k]], seen.points)
            rows.append(jnp.sqrt(seen.weights) * d)
        r = jnp.concatenate(rows) / self.unit
        good = run.converged & jnp.all(jnp.isfinite(r))
        return jnp.where(good, r, NOWHERE), Aux(good, jnp.zeros(()))


class Schedule(NamedTuple):
    """Times of the steps.

    **Attributes:**

    - `counts`: number of steps up to each observation from the one before.
    - `times`: all times, the first one included.
    - `failed`: `None`, or why the run that should space the steps did not reach the end.
    """

    counts: tuple[int, ...]
    times: Float[np.ndarray, " times"]
    failed: RESULTS | None


def schedule(
    build: Build,
    mesh: SurfaceMesh,
    x0: Float[Array, "nodes 3"],
    values: Mapping[str, float],
    times: Float[np.ndarray, " observations_plus_1"],
    rtol: float,
    counts: tuple[int, ...] | None = None,
) -> Schedule:
    """Steps from `times[0]` to every other one, spaced as an adaptive run spaces them.

    Given `counts` are kept, so that the compiled run is: only the spacing follows the new values.
    """
    flow = build({name: jnp.asarray(value) for name, value in values.items()})
    t0, t1 = float(times[0]), float(times[-1])
    run = evolve(flow, mesh, x0, t0=t0, t1=t1, rtol=rtol, throw=False)
    accepted, failed = np.asarray(run.times), None
    if not run.succeeded:
        stopped = bool(run.result == ENDS.interrupted)
        failed = RESULTS.interrupted if stopped else RESULTS.model_failed
        accepted = np.array([t0, t1])
    at = np.interp(times, accepted, np.arange(len(accepted)))
    if counts is None:
        # Two more per interval: steps that hit an observation are shorter than they might be.
        counts = tuple(int(np.ceil(gap)) + 2 for gap in np.diff(at))
    pieces = [np.linspace(at[k], at[k + 1], n + 1)[1:] for k, n in enumerate(counts)]
    grid = np.interp(np.concatenate([[0.0], *pieces]), np.arange(len(accepted)), accepted)
    grid[np.cumsum(counts)] = times[1:]
    return Schedule(counts, grid, failed)

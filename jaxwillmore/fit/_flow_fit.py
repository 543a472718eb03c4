"""FlowFit: what a fit to a time series found."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ._flow_residuals import FlowResiduals
from ._identify import NO_SOLUTION, Identification
from ._results import RESULTS
from ._shape_fit import distances
from ._targets import Target
from ._verdict import Verdict, judged

MOBILITY_IS_INVISIBLE = (
    "The mobility is taken as 1: a flow shows only the products of mobility with moduli and forces."
)


@dataclasses.dataclass(frozen=True)
class SeenShape:
    """The flow at the time of one observation.

    **Attributes:**

    - `time`, `mesh`, `x`: the surface of the model then.
    - `distances`: `rms` and `largest` of the signed distances of the target's nodes to the model,
      and `largest_back`, that of the model's nodes to the target.
    - `residual`: the signed distance of every node of the target, positive outside of the model.
    """

    time: float
    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]
    distances: dict[str, float]
    residual: Float[np.ndarray, " points"]


@dataclasses.dataclass(frozen=True)
class FlowFit:
    """The end of a fit to a time series.

    **Attributes:**

    - `parameters`: values by name.
    - `identification`: their intervals, singular values and null directions.
    - `rms`: root mean square of the distances over the area radius of the start; NaN where the
      flow had no solution.
    - `residuals`, `u`, `jacobian`: the problem on its last schedule, its solution, and the
      derivative there.
    - `targets`: the observations.
    - `history`, `result`, `stats`: accepted steps, why it ended, what it cost.
    """

    parameters: dict[str, float]
    identification: Identification
    rms: float
    residuals: FlowResiduals
    u: Float[Array, " unknowns"]
    jacobian: Float[np.ndarray, "rows unknowns"]
    targets: tuple[Target, ...]
    history: tuple[dict[str, float], ...]
    result: RESULTS
    stats: dict[str, Any]

    @property
    def succeeded(self) -> bool:
        """Whether the distance is least at parameters that the data determine."""
        return bool(self.result == RESULTS.converged)

    def in_words(self) -> tuple[str, ...]:
        """What this series does not tell, one sentence each."""
        if not np.isfinite(self.rms):
            return (NO_SOLUTION,)
        return (MOBILITY_IS_INVISIBLE, *self.identification.in_words())

    def misfit(self, u: Float[Array, " unknowns"]) -> tuple[float, bool]:
        """Norm of the residuals for other unknowns, and whether the flow exists."""
        size, solved, _ = _looked(self.residuals, u)
        return float(size), bool(solved)

    def shapes(self) -> tuple[SeenShape, ...]:
        """The flow at the times of the observations, by one more run."""
        nodes, r = _looked(self.residuals, self.u)[2], self.residuals
        found = []
        for target, t, x in zip(self.targets, r.times[r.seen_at], nodes, strict=True):
            numbers, signed = distances(target, r.mesh, np.asarray(x))
            found.append(SeenShape(float(t), r.mesh, x, numbers, signed))
        return tuple(found)

    def judged(
        self, noise: float | None = None, shapes: tuple[SeenShape, ...] | None = None
    ) -> Verdict:
        """Whether the flow explains the observations.

        - `noise`: standard deviation of independent errors of the nodes of the targets.
        - `shapes`: those of `FlowFit.shapes` where they are at hand; else by one more run.
        """
        shapes = self.shapes() if shapes is None else shapes
        known = self.identification.identifiable
        return judged(self.targets, shapes, self.result, known, noise)


@eqx.filter_jit
def _looked(residuals: FlowResiduals, u):
    """Norm of the residuals, whether there is a solution, and its nodes when it was seen."""
    run = residuals.run(u)
    r, aux = residuals.compared(run)
    return jnp.linalg.norm(r), aux.solved, run.x[residuals.seen_at]

"""The loop of a fit of two phases: a frozen reference, a descent on it, a new reference."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._observers import asks_to_stop
from ..equilibria import Equilibrium, equilibrium
from ..surface import area_radius
from ._descend import Descent, Iterate, descend
from ._misfit import node_weights
from ._phase_residuals import MEAN, REDUCED_VOLUME, Build, PhaseResiduals
from ._pose import Pose, aligned
from ._results import RESULTS
from ._shape_residuals import Model, bare
from ._targets import Target

# Part of R0, and change of the concentration, that count as one against damping and each other.
RESOLUTION = 1e-2
# A stage ends when the model has moved this far from its reference, in R0; the last is repeated on
# a new one unless it moved less than the second number.
STRAIN_LIMIT, SETTLED_STRAIN = 0.08, 0.02
MAX_STAGES = 10


def near(build: Build, values, model: Equilibrium, x, c) -> Equilibrium:
    """The equilibrium near a shape, with what the model holds and what is given beside."""
    inside = dict(values)
    own = model.parameters
    ball = float(own.area) ** 1.5 / (6 * np.sqrt(np.pi))
    volume = float(inside.pop(REDUCED_VOLUME)) * ball if REDUCED_VOLUME in inside else own.volume
    assert own.amount is not None
    amount = inside.pop(MEAN) * own.area if MEAN in inside else own.amount
    held: dict[str, Any] = {"area": float(own.area)} if model.fixed_area else {"area": None}
    if model.fixed_volume:
        held["volume"] = float(volume)
    else:
        held["pressure"] = float(own.pressure)
    return equilibrium(
        model.mesh,
        x,
        build(inside),
        c=c,
        amount=float(amount),
        stability=False,
        throw=False,
        **held,
    )


def placed(residuals: PhaseResiduals, target: Target, u) -> PhaseResiduals:
    """The model as it is turned, or with its principal axes along those of the target.

    The best of the five: an axis of symmetry leaves the turn about it to chance.
    """
    shape = residuals.model.equilibrium
    size = float(target.radius / area_radius(shape.mesh, shape.x))
    own, there = node_weights(shape.mesh, shape.x), node_weights(target.mesh, target.x)
    x, points, own, there = (np.asarray(a) for a in (shape.x, target.x, own, there))
    shift = there @ points / there.sum() - size * own @ x / own.sum()
    as_it_is = Pose(jnp.eye(3), jnp.asarray(shift), jnp.asarray(size))
    poses = [as_it_is, *aligned(x, own, points, there, size)]
    moved = [eqx.tree_at(lambda r: r.model.pose, residuals, pose) for pose in poses]
    return moved[int(np.argmin([float(_apart(r, u)) for r in moved]))]


@eqx.filter_jit
def _apart(residuals: PhaseResiduals, u):
    """Norm of the residuals with the model as it is, not solved for anything."""
    shape = residuals.model.equilibrium
    x = residuals.model.pose.place(shape.x, residuals.motion(u))
    return jnp.linalg.norm(residuals.compared(x, shape.c))


class PhaseMatcher:
    """The loop over stages: a frozen reference, a descent on it, a new reference."""

    def __init__(self, residuals, target: Target, tolerance, max_steps, observer, interrupted):
        self.residuals, self.target = residuals, target
        self.tolerance, self.max_steps = tolerance, max_steps
        self.observer, self.interrupted = observer, interrupted
        self.history: list[dict[str, float]] = []
        self.steps = self.stages = 0

    def run(self, u, new_references: bool) -> Descent:
        """Descend until the model is near its own reference."""
        while True:
            self.stages += 1
            descent = descend(
                self.residuals,
                u,
                tolerance=self.tolerance,
                max_steps=self.max_steps - self.steps,
                strain_limit=STRAIN_LIMIT if new_references else np.inf,
                observer=self._seen,
                interrupted=self.interrupted,
            )
            self.steps += descent.steps
            result, u = descent.result, descent.u
            if result is not None and not bool(result == RESULTS.converged):
                return descent
            if not new_references or descent.strain <= SETTLED_STRAIN:
                return descent
            if self.stages >= MAX_STAGES or not self._new_reference(descent):
                end = RESULTS.interrupted if self.interrupted() else RESULTS.stalled
                return descent._replace(result=end)
            u = jnp.concatenate([u[: len(self.residuals.labels)], jnp.zeros(7)])

    def _new_reference(self, descent: Descent) -> bool:
        assert descent.aux is not None
        r, u, found = self.residuals, descent.u, descent.aux.model
        own = r.model.equilibrium
        shape = near(r.build, r.values(u), own, found.x, found.c)
        if not shape.succeeded:
            return False
        model = Model(bare(shape), r.model.pose.moved(r.motion(u)))
        self.residuals = eqx.tree_at(lambda r: r.model, r, model)
        return True

    def _seen(self, iterate: Iterate) -> bool:
        row = {
            "step": float(len(self.history)),
            "stage": float(self.stages),
            "rms": float(np.sqrt(2 * iterate.objective)) * RESOLUTION,
            "strain": iterate.strain,
        }
        row |= {n: float(v) for n, v in self.residuals.values(iterate.u).items()}
        self.history.append(row)
        return self.observer is not None and asks_to_stop(self.observer(row))

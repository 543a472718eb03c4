"""Differences between an equilibrium of two phases and an observed surface with a concentration."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..energies import TwoPhase
from ..equilibria import Resolved
from ..fem import gather, rule_for
from ..surface import distance_and_value
from ._conclusion import values_of
from ._descend import Aux
from ._parameters import AbstractRange
from ._shape_residuals import NOWHERE, Model
from ._targets import SAMPLING, Target

Build = Callable[[dict[str, Array]], TwoPhase]
# Names of parameters that are no part of the energy.
REDUCED_VOLUME, MEAN = "reduced_volume", "mean"


class ObservedPhases(eqx.Module):
    """Points of a surface, their weights, and the concentration there; padded with weight zero."""

    points: Float[Array, "points 3"]
    weights: Float[Array, " points"]
    concentration: Float[Array, " points"]


def observed_phases(target: Target, c: Float[Array, " nodes"]) -> ObservedPhases:
    """The concentration at the points where the distance of a target is taken."""
    if target.mesh.degree > 1:
        rule = rule_for(target.mesh, SAMPLING)
        c = (gather(target.mesh, c[:, None])[..., 0] @ rule.phi[:, :, 0].T).reshape(-1)
    padded = np.pad(np.asarray(c), (0, len(target.points) - len(c)))
    return ObservedPhases(target.points, target.weights, jnp.asarray(padded))


class PhaseResiduals(eqx.Module):
    r"""Signed distances of the points to the model, and differences of the concentration there.

    Unknowns are the free parameters and seven numbers of motion, `Pose.place`.

    **Attributes:**

    - `build`: parameters by name to an energy.
    - `labels`, `ranges`: of the free parameters.
    - `model`: an equilibrium and where it stands.
    - `observed`: the points.
    - `unit`, `unit_c`: a distance and a concentration that count as one, times the square root of
      the number of points.
    """

    build: Build = eqx.field(static=True)
    labels: tuple[str, ...] = eqx.field(static=True)
    ranges: tuple[AbstractRange, ...]
    model: Model
    observed: ObservedPhases
    unit: Float[Array, ""]
    unit_c: Float[Array, ""]

    def values(self, u: Float[Array, " unknowns"]) -> dict[str, Array]:
        """Parameters by name."""
        return values_of(self, u)

    def motion(self, u: Float[Array, " unknowns"]) -> Float[Array, "7"]:
        """Turn, shift and size."""
        return u[len(self.labels) :]

    def solved(self, u: Float[Array, " unknowns"]) -> tuple[Resolved, Array, Array]:
        """The equilibrium, whether it exists, and its nodes in their place."""
        values = self.values(u)
        own = self.model.equilibrium.parameters
        ball = own.area**1.5 / (6 * jnp.sqrt(jnp.pi))
        volume = values.pop(REDUCED_VOLUME) * ball if REDUCED_VOLUME in values else own.volume
        amount = values.pop(MEAN) * own.area if MEAN in values else own.amount
        p = eqx.tree_at(
            lambda p: (p.two_phase, p.volume, p.amount), own, (self.build(values), volume, amount)
        )
        found, exists = self.model.at(p)
        return found, exists, self.model.pose.place(found.x, self.motion(u))

    def compared(self, x, c) -> Float[Array, " rows"]:
        """Differences of a model with given nodes in their place, and its concentration."""
        seen, cells = self.observed, self.model.equilibrium.mesh.cells
        distance, there = distance_and_value(cells, x, c, seen.points)
        parts = distance / self.unit, (seen.concentration - there) / self.unit_c
        return jnp.concatenate([jnp.sqrt(seen.weights) * part for part in parts])

    def __call__(self, u: Float[Array, " unknowns"]) -> tuple[Float[Array, " rows"], Aux]:
        found, exists, x = self.solved(u)
        rows, equilibrium = self.compared(x, found.c), self.model.equilibrium
        good = exists & jnp.all(jnp.isfinite(rows))
        away = found.x - equilibrium.units.outward(equilibrium.reference.X)
        strain = jnp.max(jnp.linalg.norm(away, axis=1)) / equilibrium.units.length
        return jnp.where(good, rows, NOWHERE), Aux(good, strain, model=found)

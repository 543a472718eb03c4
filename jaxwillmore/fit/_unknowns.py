"""Which parameters of which target are free, and where they stand in the vector of unknowns."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._parameters import AbstractRange, Between, Unbounded
from ._pose import POSE_NAMES

SHAPE_PARAMETERS = ("reduced_volume", "scaled_spontaneous_curvature", "scaled_pressure")
MEANINGS = {
    "reduced_volume": "reduced volume",
    "scaled_spontaneous_curvature": "H0·R0",
    "scaled_pressure": "P·R0³/κ",
}
RANGES = {
    # Near 1 area and volume cannot be held together.
    "reduced_volume": (0.25, 0.997),
    "scaled_spontaneous_curvature": (-10.0, 10.0),
    "scaled_pressure": None,
}


class Unknowns(eqx.Module):
    """The vector of unknowns of a fit to several targets.

    First the free parameters, those that are shared once and the others target by target; then
    seven numbers of motion for every target.

    **Attributes:**

    - `labels`: names of the free parameters, such as `"reduced_volume[1]"`.
    - `ranges`: one for each label.
    - `places`: for every target, name by name, its label's number, or -1 where it is held.
    - `held`: values of the parameters that are held, for every target and name.
    """

    labels: tuple[str, ...] = eqx.field(static=True)
    places: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    ranges: tuple[AbstractRange, ...]
    held: Float[Array, "targets 3"]

    @property
    def n_targets(self) -> int:
        """Number of targets."""
        return len(self.places)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return len(self.labels) + len(POSE_NAMES) * self.n_targets

    @eqx.filter_jit
    def free(self, u: Float[Array, " unknowns"]) -> Float[Array, " labels"]:
        """Values of the free parameters."""
        values = [r.value(u[k]) for k, r in enumerate(self.ranges)]
        return jnp.stack(values) if values else jnp.zeros(0)

    @eqx.filter_jit
    def parameters(self, u: Float[Array, " unknowns"], target: int) -> dict[str, Array]:
        """Parameters of one target by name."""
        free = self.free(u)
        place = self.places[target]
        return {
            name: self.held[target, i] if place[i] < 0 else free[place[i]]
            for i, name in enumerate(SHAPE_PARAMETERS)
        }

    def motion(self, u: Float[Array, " unknowns"], target: int) -> Float[Array, "7"]:
        """Motion of one target's model."""
        start = len(self.labels) + len(POSE_NAMES) * target
        return u[start : start + len(POSE_NAMES)]

    def start(self, values: Sequence[Mapping[str, float]]) -> Float[Array, " unknowns"]:
        """The vector for given parameters of every target, without motion.

        **Raises:** `ValueError` for a value out of its range.
        """
        u = np.zeros(self.size)
        for place, given in zip(self.places, values, strict=True):
            for i, name in enumerate(SHAPE_PARAMETERS):
                if place[i] >= 0:
                    try:
                        u[place[i]] = self.ranges[place[i]].unknown(float(given[name]))
                    except ValueError as error:
                        raise ValueError(f"Start of `{name}`: {error}") from None
        return jnp.asarray(u)

    @eqx.filter_jit
    def slopes(self, u: Float[Array, " unknowns"]) -> Float[Array, " labels"]:
        """Derivative of each free parameter by its unknown."""
        each = [jax.grad(r.value)(u[k]) for k, r in enumerate(self.ranges)]
        return jnp.stack(each) if each else jnp.zeros(0)

    def on_bound(self, u: Float[Array, " unknowns"]) -> tuple[str, ...]:
        """Labels of the parameters that sit on a bound."""
        values = np.asarray(self.free(u))
        each = zip(self.labels, self.ranges, values, strict=True)
        return tuple(label for label, r, value in each if r.on_bound(float(value)))


def unknowns(
    free: Sequence[str],
    shared: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    held: Sequence[Mapping[str, float]],
) -> Unknowns:
    """Lay out the free parameters.

    **Raises:** `ValueError` for names that are no parameters of a shape.
    """
    for what, names in (("free", free), ("shared", shared), ("bounds", bounds)):
        for name in names:
            if name not in SHAPE_PARAMETERS:
                raise ValueError(f"`{what}` has {name!r}; there are {', '.join(SHAPE_PARAMETERS)}.")
    labels: list[str] = []
    ranges: list[AbstractRange] = []
    places = []
    for k in range(len(held)):
        place = []
        for name in SHAPE_PARAMETERS:
            if name not in free:
                place.append(-1)
                continue
            label = name if len(held) == 1 or name in shared else f"{name}[{k}]"
            if label not in labels:
                labels.append(label)
                bound = bounds.get(name, RANGES[name])
                ranges.append(Unbounded() if bound is None else Between(*bound))
            place.append(labels.index(label))
        places.append(tuple(place))
    table = [[float(values.get(name, 0.0)) for name in SHAPE_PARAMETERS] for values in held]
    return Unknowns(tuple(labels), tuple(places), tuple(ranges), jnp.asarray(table))


def of_unit_size(parameters: Mapping[str, float], size: float, by_pressure: bool) -> dict[str, Any]:
    """What `equilibrium` is given for these parameters, with R0 = 1 and κ = 1.

    - `size`: area radius of the target over the mean of all, in which $H_0R_0$ is.
    - `by_pressure`: hold the pressure in place of the volume.
    """
    held = "scaled_pressure" if by_pressure else "reduced_volume"
    return {
        "area": 4 * math.pi,
        "spontaneous_curvature": parameters["scaled_spontaneous_curvature"] * size,
        held.removeprefix("scaled_"): parameters[held],
    }


def spoken(label: str) -> str:
    """Words for a label, such as `reduced volume of target 1`."""
    name, _, number = label.removesuffix("]").partition("[")
    return MEANINGS.get(name, name) + (f" of target {number}" if number else "")

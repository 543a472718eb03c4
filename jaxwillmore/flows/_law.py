r"""What a law states about itself: fields with their equations, and what it gives to the others.

A flow is a `System` of laws. A law is one idea (bending, a load, the kinetics of a concentration, a
tangential motion) and says, in a `Statement`, which fields it brings and in which equation each is
determined, what it reads of the fields of others, where it starts, how large its unknowns are, and
which energy it lowers. The system does the rest: columns, stages, scales, the transport of every
field by its role, global unknowns and records.
"""

import abc
import dataclasses
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import AbstractEnergy
from ..fem import Jet, Point
from ..mesh import SurfaceMesh
from ..surface import weingarten

Scalar = Float[Array, ""]

# How a field changes in time where nodes slip along the surface with the velocity w.
Role = Literal["algebraic", "geometric", "material", "conserved"]


@dataclasses.dataclass(frozen=True)
class Units:
    """What the sizes of unknowns are made of.

    **Attributes:**

    - `length`: $R = \\sqrt{A/4\\pi}$, the size of the surface.
    - `potential`: typical chemical potential, energy/length²; one where no law has one.
    - `time`: in which the flow moves a surface of that size by about its size.
    """

    length: Scalar
    potential: Scalar
    time: Scalar

    @property
    def velocity(self) -> Scalar:
        """Length over time."""
        return self.length / self.time


class Local:
    r"""Everything that an equation may read at one quadrature point.

    **Attributes:**

    - `point`: position, element normal, area element.
    - `rate`: discrete material derivatives of the fields that have one, `rate.H` for instance. For
      a conserved field it is the part of $\mathrm d(c,\chi)/\mathrm dt$ on the new surface.
    - `hat`: jets of the fields at which coefficients are evaluated; equal to `trial` in the fully
      implicit scheme, extrapolated in the linearly implicit one.
    - `trial`: jets of the unknowns, which equations are linear in where they can be.
    - `data`: jets of nodal data and of parameters that sit on the nodes.
    - `multipliers`: global unknowns by name.
    """

    def __init__(self, laws, point: Point, rate, hat, trial, data, multipliers):
        self._laws = laws
        self.point, self.rate, self.hat, self.trial = point, rate, hat, trial
        self.data, self.multipliers = data, multipliers

    @property
    def A(self) -> Float[Array, "3 3"]:
        r"""The Weingarten map $A_h = \mathrm{sym}\,\nabla\nu_h$ of the coefficients."""
        return weingarten(self.hat.nu)

    def force(self) -> Scalar:
        """The normal force of all laws that exert one; part of Q in the law of the surface."""
        return sum((law.force(self) for law in self._laws if law.force), start=jnp.zeros(()))

    def density(self, c: Jet) -> Scalar:
        """The energy per area of all laws as a function of the concentration, all else fixed."""
        parts = (law.density(self, c) for law in self._laws if law.density)
        return sum(parts, start=jnp.zeros(()))


@dataclasses.dataclass(frozen=True)
class Whole:
    """A surface with its fields: what nodal data, global equations and records are made of.

    **Attributes:**

    - `t`, `mesh`, `x`: time and nodes.
    - `fields`: nodal fields by name, parameters that sit on the nodes among them.
    - `multipliers`: global unknowns by name.
    - `units`: of the surface.
    """

    t: Scalar
    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]
    fields: dict[str, Array]
    multipliers: SimpleNamespace
    units: Units


@dataclasses.dataclass(frozen=True)
class Field:
    r"""An unknown on the nodes and the equation that determines it.

    **Attributes:**

    - `equation`: left side minus right side at one quadrature point, `(local, chi) -> scalar`, with
      the test function `chi`. The transport by a tangential motion is not part of it.
    - `scale`: typical size, a function of `Units`.
    - `role`: *algebraic*: the equation has no time derivative; *geometric*: H and ν, which belong
      to the surface itself; *material*: it stays on its material points, which move with $V\nu$;
      *conserved*: a density whose integral only its flux changes.
    - `components`: 1 or 3.
    - `error_weight`: how much a change of the field by its scale counts in the local error of a
      step, against a motion by the size of the surface; 0: it is not watched.
    """

    name: str
    equation: Callable[[Local, Jet], Scalar]
    scale: Callable[[Units], Scalar]
    role: Role = "algebraic"
    components: int = 1
    error_weight: float = 0.0


@dataclasses.dataclass(frozen=True)
class Globals:
    """Numbers that are unknowns of a step: multipliers, pressures.

    **Attributes:**

    - `closures`: one equation per number on the new surface, scaled to order one.
    - `scales`: typical sizes.
    """

    names: tuple[str, ...]
    closures: Callable[[Whole], Float[Array, " globals"]]
    scales: Callable[[Units], Float[Array, " globals"]]


@dataclasses.dataclass(frozen=True)
class Statement:
    r"""All that a law says; everything but what it needs may be left out.

    **Attributes:**

    - `fields`: its unknowns.
    - `stages`: names of its fields in groups that decouple where coefficients are frozen, in order
      of solution.
    - `reads`: fields of other laws that it cannot do without.
    - `start`: `(mesh, x, given) -> fields`, initial values of its fields that have a time
      derivative: as given, or recovered.
    - `velocity`: what it adds to the velocity of a node, from the unknowns there.
    - `position`: where the nodes are at a time, for a surface whose motion is given.
    - `force`: normal force that it exerts on the surface, at one point.
    - `density`: its energy per area as a function `(local, c)` of the concentration, at one point.
    - `needs_density`: whether it follows the derivative of that density by the concentration.
    - `data`: nodal data of a step by name, functions of the surface extrapolated to the new time
      (with those of the old surface the step would be of first order in time).
    - `carried`: parameters that sit on material points, by name, one number for every node.
    - `globals`: its global unknowns.
    - `energy`: what it lowers.
    - `lowers_energy`: whether all that it does lowers the energy of the system; a prescribed
      motion, a forcing or a ramp does work, and steps are then not rejected for it.
    - `length_time`: the time in which it moves a surface of a given size by about that size.
    - `potential`: typical chemical potential on a surface of a given size.
    - `diffusion_time`: likewise for its fields, `(length, potential) -> time`.
    - `record`: columns of the history, `Whole -> numbers`.
    - `activity`: how far it is from rest, scaled to order one.
    - `implicit_only`: its equations are not linear in `trial`.
    """

    fields: tuple[Field, ...] = ()
    stages: tuple[tuple[str, ...], ...] = ()
    reads: tuple[str, ...] = ()
    start: Callable[..., dict[str, Array]] | None = None
    velocity: Callable[[SimpleNamespace], Float[Array, "3"]] | None = None
    position: Callable[[Scalar], Float[Array, "nodes 3"]] | None = None
    force: Callable[[Local], Scalar] | None = None
    density: Callable[[Local, Jet], Scalar] | None = None
    needs_density: bool = False
    data: Mapping[str, Callable[[Whole], Float[Array, " nodes"]]] = dataclasses.field(
        default_factory=dict
    )
    carried: Mapping[str, Float[Array, "..."]] = dataclasses.field(default_factory=dict)
    globals: Globals | None = None
    energy: AbstractEnergy | None = None
    lowers_energy: bool = True
    length_time: Callable[[Scalar], Scalar] | None = None
    potential: Callable[[Scalar], Scalar] | None = None
    diffusion_time: Callable[[Scalar, Scalar], Scalar] | None = None
    record: Callable[[Whole], dict[str, Scalar]] | None = None
    activity: Callable[[Whole], Scalar] | None = None
    implicit_only: bool = False


class AbstractLaw(eqx.Module):
    """One law of a `System`; its parameters are differentiable leaves."""

    @abc.abstractmethod
    def statement(self) -> Statement:
        """What the law states about itself."""

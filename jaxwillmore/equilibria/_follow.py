"""Predictor and corrector along a family of equilibria, in dimensionless unknowns."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..linalg import HostMatrix
from ._functional import EquilibriumSystem, Path, Reference, concentration
from ._line import line
from ._parameters import Units
from ._reference import advanced
from ._relax import Relaxation, settle
from ._shape import Equilibrium
from ._solve import Solved, arrays_of, jacobian_of


class Point(eqx.Module):
    """Where the branch is: a reference surface at its shape, unknowns, and the tangent there."""

    reference: Reference
    y: Float[Array, "nodes fields"]
    g: Float[Array, " globals"]
    tangent_s: Float[Array, " nodes"]
    tangent_y: Float[Array, "nodes fields"]
    tangent_g: Float[Array, " globals"]

    @property
    def p(self) -> float:
        """Scaled parameter."""
        return float(self.g[-1])

    def turned(self, steps: tuple) -> "Point":
        """With the tangent along a change of displacements, fields and global unknowns."""
        s, _, g = steps
        norm = length_of(self.reference, s, g[-1])
        where = lambda p: (p.tangent_s, p.tangent_y, p.tangent_g)
        return eqx.tree_at(where, self, tuple(step / norm for step in steps))


def length_of(r: Reference, s: Float[Array, " nodes"], p) -> float:
    """Arclength of a change: the mean normal displacement and that of the scaled parameter."""
    return float(jnp.sqrt(jnp.sum(s * r.times_mass(s)) / jnp.sum(r.mass) + p**2))


class Follower:
    """A family of equilibria along one parameter, and where on it we stand."""

    def __init__(self, start: Equilibrium, parameter: str, tolerance: float, linear_solver: str):
        flags = start.fixed_area, start.fixed_volume
        self.units: Units = start.units
        self.linear_solver = linear_solver
        self.relaxation = Relaxation(start.mesh, flags, tolerance, linear_solver)
        self.base, self.direction, self.scale, self.value = line(start, parameter)
        y, g = start.nodal_unknowns
        r = self.relaxation.reference(self.units.inward(start.x), start.c)
        g = g.at[-1].set(self.value / self.scale)
        zero = jnp.zeros_like
        self.point = Point(r, y, g, zero(y[:, 0]), zero(y), zero(g))

    def head(self, stop: float) -> None:
        """The first tangent, towards the value `stop` of the parameter."""
        here, side = self.point, float(np.sign(stop - self.value))
        system = self.system(here.reference, self.prescribed(here.p))
        v = system.pack(jnp.zeros_like(here.tangent_s), here.y, here.g)
        rate = self.tangent(system, v)
        self.point = here.turned(tuple(side * step for step in system.unpack(rate)))

    def first_length(self, step: float, displaced: float) -> float:
        """Arclength that changes the scaled parameter by `step`, or moves a node by `displaced`."""
        here = self.point
        fastest = float(jnp.max(jnp.abs(here.tangent_s)))
        return min(step / abs(float(here.tangent_g[-1])), displaced / max(fastest, 1e-12))

    def tangent(self, system: EquilibriumSystem, v: Float[Array, " unknowns"]):
        """Derivative of the unknowns by the right-hand side of the equation of the path."""
        blocks, border = arrays_of(jacobian_of(system, v))
        matrix = HostMatrix(system.pattern, blocks, border, (), self.linear_solver)
        rhs = np.zeros(len(v))
        rhs[-1] = 1.0
        rate = matrix.solve(rhs, 1e-8)[0]
        matrix.release()
        return jnp.asarray(rate)

    def system(self, r: Reference, path: Path) -> EquilibriumSystem:
        """The equations on a reference surface, with an equation that picks the point."""
        system = self.relaxation.system(r, self.base)
        return eqx.tree_at(lambda s: s.path, system, path)

    def prescribed(self, p) -> Path:
        """The equation that prescribes the scaled parameter."""
        nowhere = jnp.zeros_like(self.point.tangent_s)
        return Path(self.direction, nowhere, jnp.ones(()), jnp.asarray(p, float))

    def along(self, length: float) -> tuple[EquilibriumSystem, Solved]:
        """Correct the prediction at pseudo-arclength `length`."""
        here = self.point
        area = float(jnp.sum(here.reference.mass))
        shape = here.reference.times_mass(here.tangent_s) / area
        weight = here.tangent_g[-1]
        path = Path(self.direction, shape, weight, length + weight * here.g[-1])
        return self._corrected(path, length)

    def to(self, p: float) -> tuple[EquilibriumSystem, Solved]:
        """Correct the prediction at a prescribed scaled parameter."""
        here = self.point
        length = (p - here.p) / float(here.tangent_g[-1])
        return self._corrected(self.prescribed(p), length)

    def _corrected(self, path: Path, length: float) -> tuple[EquilibriumSystem, Solved]:
        here = self.point
        system = self.system(here.reference, path)
        g = here.g + length * here.tangent_g
        y = here.y + length * here.tangent_y
        solved = self.relaxation.solve(system, y, g, length * here.tangent_s)
        return system, solved

    def bend(self, system: EquilibriumSystem, solved: Solved) -> float:
        """Length of a step over that of its projection on the tangent: 1 for a straight branch."""
        here = self.point
        s, _, g = system.unpack(solved.unknowns)
        change = g[-1] - here.g[-1]
        area = jnp.sum(here.reference.mass)
        shadow = jnp.sum(s * here.reference.times_mass(here.tangent_s)) / area
        shadow = shadow + change * here.tangent_g[-1]
        return length_of(here.reference, s, change) / max(abs(float(shadow)), 1e-300)

    def settled(self, system: EquilibriumSystem, solved: Solved):
        """The same parameter again, on the reference surface that belongs to the shape."""
        s, y, g = system.unpack(solved.unknowns)
        r = self.relaxation.reference(advanced(system.reference, s), concentration(y))
        return settle(self.relaxation, self.system(r, self.prescribed(g[-1])), y, g)

    def accept(self, system: EquilibriumSystem, solved: Solved) -> None:
        """Move on: a new reference surface and the secant as seen from it."""
        here = self.point
        s, y, g = system.unpack(solved.unknowns)
        X = advanced(here.reference, s)
        r = self.relaxation.reference(X, concentration(y))
        step_s = jnp.sum((X - here.reference.X) * r.n, axis=1)
        moved = Point(r, y, g, here.tangent_s, here.tangent_y, here.tangent_g)
        self.point = moved.turned((step_s, y - here.y, g - here.g))

"""What a flow is: fields, frozen data, one weak form, and the velocity that moves the nodes."""

import abc
from collections.abc import Mapping
from types import MappingProxyType, SimpleNamespace
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from ..fem import Layout, Point
from ..mesh import SurfaceMesh


class AbstractFlow(eqx.Module):
    r"""A geometric evolution law in weak form, discretised by evolving surface finite elements.

    One function per equation is written at one quadrature point; the sum over the equations whose
    test function is present is the form. With `hat = trial` it is the fully implicit scheme, with
    `hat` extrapolated from the history it is linear in `trial`.
    """

    # The unknown fields, in column order.
    layout: eqx.AbstractVar[Layout]
    # The unknowns whose equation has a material derivative; the others are algebraic.
    evolving: eqx.AbstractVar[tuple[str, ...]]
    # Nodal data of a step.
    data: eqx.AbstractVar[Layout]
    # Names of the global unknowns, in order.
    global_names: eqx.AbstractVar[tuple[str, ...]]
    # Groups of unknowns that decouple when the coefficients are frozen, in order of solution.
    stages: eqx.AbstractVar[tuple[tuple[str, ...], ...]]
    # Parameters that sit on the nodes and stay there, by name, with one number for every node; they
    # are columns of `data` under the same names. Right where nodes move with Vν only.
    carried: ClassVar[Mapping[str, Array]] = MappingProxyType({})

    @abc.abstractmethod
    def equation(
        self,
        name: str,
        point: Point,
        rate: SimpleNamespace,
        hat: SimpleNamespace,
        trial: SimpleNamespace,
        data: SimpleNamespace,
        chi,
    ) -> Float[Array, ""]:
        """The equation tested with `chi`, the test function that carries `name`, at one point.

        `data` holds the jets of the nodal data and, as `data.multipliers`, the global unknowns.
        """

    @abc.abstractmethod
    def velocity(self, nodal: SimpleNamespace) -> Float[Array, "3"]:
        """Velocity of one node from the unknowns there."""

    @property
    def n_globals(self) -> int:
        """Number of global unknowns: multipliers and pressures."""
        return len(self.global_names)

    @abc.abstractmethod
    def closures(
        self,
        mesh: SurfaceMesh,
        t: Float[Array, ""],
        x: Float[Array, "nodes 3"],
        fields: dict[str, Array],
        multipliers: Float[Array, " globals"],
    ) -> Float[Array, " globals"]:
        """One equation per global unknown at the new nodes and fields, scaled to order one."""

    @abc.abstractmethod
    def global_scales(self, length: Float[Array, ""]) -> Float[Array, " globals"]:
        """Typical size of every global unknown."""

    @abc.abstractmethod
    def nodal_data(
        self,
        mesh: SurfaceMesh,
        t: Float[Array, ""],
        x: Float[Array, "nodes 3"],
        fields: dict[str, Array],
    ) -> Float[Array, "nodes data"]:
        """The columns of `data` for the step to `t`.

        `x` and `fields` are extrapolated to `t`: with those of the old surface the step would be of
        first order in time.
        """

    @abc.abstractmethod
    def initial_fields(
        self,
        mesh: SurfaceMesh,
        x: Float[Array, "nodes 3"],
        given: dict[str, Array],
    ) -> dict[str, Array]:
        """The evolving fields at the start: as given, or recovered from the nodes."""

    @abc.abstractmethod
    def with_carried(self, fields: dict[str, Array]) -> "AbstractFlow":
        """The flow with those parameters replaced that `fields` has as unknowns; else itself.

        A flow around it may move the nodes along the surface and solve for what they carry.
        """

    @abc.abstractmethod
    def energy(self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
        """The energy that the law lowers, from the nodes alone."""

    @abc.abstractmethod
    def energy_scale(self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
        r"""The sizes of the terms of the energy, added: $\sum_i |E_i|$ for $E = \sum_i E_i$.

        What a change of the energy is small against. The energy itself passes through zero where
        its terms cancel, and their discretisation errors do not.
        """

    @abc.abstractmethod
    def scales(self, length: Float[Array, ""]) -> Float[Array, " fields"]:
        """Typical size of every column of the unknowns on a surface of size `length`."""

    @abc.abstractmethod
    def time_scale(self, length: Float[Array, ""]) -> Float[Array, ""]:
        """Time in which the law moves a surface of size `length` by about its size."""

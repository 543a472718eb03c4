"""What a scheme is: unknowns, frozen data, and linear equations for the next surface."""

import abc
from types import SimpleNamespace

import equinox as eqx
from jaxtyping import Array, Float

from ..fem import Jet, Layout, Point, Rule
from ..mesh import SurfaceMesh


class AbstractScheme(eqx.Module):
    r"""One linear system per step, posed on the old surface $\Gamma^n$, whose solution holds
    $x^{n+1}$.

    Unlike a flow, which is a law and leaves time to `jaxwillmore.evolve`, a scheme from the
    literature fixes what is taken at the old and what at the new time; its order in the step is 1.
    Every equation is affine in the unknowns and written at one quadrature point; the matrix and the
    right-hand side are made from it (`jaxwillmore.schemes.step`).
    """

    # The unknown fields in column order; `x`, the new nodes, is one of them.
    layout: eqx.AbstractVar[Layout]
    # Nodal fields that a step takes from the past.
    data: eqx.AbstractVar[Layout]

    @abc.abstractmethod
    def rule(self, mesh: SurfaceMesh) -> Rule:
        """Quadrature of the scheme, which may lump masses.

        **Raises:** `ValueError` for a degree that the scheme is not made for.
        """

    @abc.abstractmethod
    def equation(
        self,
        name: str,
        point: Point,
        trial: SimpleNamespace,
        data: SimpleNamespace,
        tau: Float[Array, ""],
        chi: Jet,
    ) -> Float[Array, ""]:
        """The equation tested with `chi`, the test function that carries `name`, at one point.

        `point` and all gradients belong to the old surface; `point.position` is $x^n$.
        """

    @abc.abstractmethod
    def nodal_data(
        self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"], fields: dict[str, Array]
    ) -> dict[str, Array]:
        """The fields of `data` from the old nodes and the other old unknowns."""

    @abc.abstractmethod
    def initial_fields(
        self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]
    ) -> dict[str, Float[Array, "nodes ..."]]:
        """The unknowns other than `x` at the start, recovered from the nodes."""

    @abc.abstractmethod
    def scales(self, length: Float[Array, ""]) -> Float[Array, " fields"]:
        """Typical size of every column of the unknowns on a surface of size `length`."""

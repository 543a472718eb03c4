"""The algebra of energies."""

import abc
from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh


class AbstractEnergy(eqx.Module):
    """A number that a flow or a minimiser lowers; differentiable in `x` and in its parameters.

    Energies form a vector space: `a + 2.0 * b - c / 3`, `sum([a, b])`.
    """

    @abc.abstractmethod
    def __call__(
        self,
        mesh: SurfaceMesh,
        x: Float[Array, "nodes 3"],
        fields: Mapping[str, Array] | None = None,
    ) -> Float[Array, ""]:
        """The energy of the surface `(mesh, x)`.

        **Arguments:**

        - `fields`: nodal arrays of the moment by name: the concentration `c`, parameters that are
          carried along. An energy takes what it knows and ignores the rest.
        """

    # The one method with a body that energies replace: an energy of a user needs none of its own.
    def scale(
        self,
        mesh: SurfaceMesh,
        x: Float[Array, "nodes 3"],
        fields: Mapping[str, Array] | None = None,
    ) -> Float[Array, ""]:
        """The sizes of its terms, added: what the errors of an energy are relative to.

        Terms may cancel; their errors do not. An energy of one term has the size of its value.
        """
        return jnp.abs(self(mesh, x, fields))

    def __add__(self, other: "AbstractEnergy") -> "AbstractEnergy":
        if not isinstance(other, AbstractEnergy):
            return NotImplemented
        return Combination((self, other), (1.0, 1.0))

    def __radd__(self, other) -> "AbstractEnergy":
        # `sum` starts from the integer 0.
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __neg__(self) -> "AbstractEnergy":
        return Combination((self,), (-1.0,))

    def __sub__(self, other: "AbstractEnergy") -> "AbstractEnergy":
        if not isinstance(other, AbstractEnergy):
            return NotImplemented
        return Combination((self, other), (1.0, -1.0))

    def __mul__(self, factor) -> "AbstractEnergy":
        return Combination((self,), (factor,))

    __rmul__ = __mul__

    def __truediv__(self, divisor) -> "AbstractEnergy":
        return Combination((self,), (1 / jnp.asarray(divisor, float),))


def terms_of(energy: AbstractEnergy) -> list[tuple[Float[Array, ""], AbstractEnergy]]:
    """A sum taken apart: factors and energies that are no sums themselves."""
    if not isinstance(energy, Combination):
        return [(jnp.ones(()), energy)]
    return [
        (factor * inner, term)
        for factor, part in zip(energy.factors, energy.terms, strict=True)
        for inner, term in terms_of(part)
    ]


class Combination(AbstractEnergy):
    """A linear combination of energies."""

    terms: tuple[AbstractEnergy, ...]
    factors: tuple[Float[Array, ""], ...]

    def __init__(self, terms, factors):
        self.terms = tuple(terms)
        self.factors = tuple(jnp.asarray(f, float) for f in factors)

    def __call__(self, mesh, x, fields=None):
        parts = (f * term(mesh, x, fields) for f, term in self._pairs())
        return sum(parts, start=jnp.zeros(()))

    def scale(self, mesh, x, fields=None):
        parts = (jnp.abs(f) * term.scale(mesh, x, fields) for f, term in self._pairs())
        return sum(parts, start=jnp.zeros(()))

    def _pairs(self):
        return zip(self.factors, self.terms, strict=True)

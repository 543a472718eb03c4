"""The algebra of energies."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh


class AbstractEnergy(eqx.Module):
    """A number that a flow or a minimiser lowers; differentiable in `x` and in its parameters.

    Energies add and scale: `a + 2.0 * b`.
    """

    @abc.abstractmethod
    def __call__(self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
        """The energy of the surface `(mesh, x)`."""

    def __add__(self, other: "AbstractEnergy") -> "AbstractEnergy":
        if not isinstance(other, AbstractEnergy):
            return NotImplemented
        return Combination((self, other), (1.0, 1.0))

    def __mul__(self, factor) -> "AbstractEnergy":
        return Combination((self,), (factor,))

    __rmul__ = __mul__


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

    def __call__(self, mesh, x):
        values = [term(mesh, x) for term in self.terms]
        parts = (f * value for f, value in zip(self.factors, values, strict=True))
        return sum(parts, start=jnp.zeros(()))

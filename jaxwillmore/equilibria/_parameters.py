"""What an equilibrium depends on, in the units of the user and without dimension."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import AbstractEnergy, AbstractGlobalEnergy, TwoPhase, terms_of
from ._phases import ScaledPhases


class Parameters(eqx.Module):
    r"""What an equilibrium depends on.

    **Attributes:**

    - `bending_modulus`: $b_b = \kappa/2$, energy.
    - `spontaneous_curvature`: $H_0$, 1/length.
    - `area`, `volume`: the values held, where they are held.
    - `tension`, `pressure`: $\sigma$ and $P = P_{in} - P_{out}$ that are applied, where area or
      volume are free.
    - `global_energy`: a sum of energies of area, volume and total mean curvature, or `None`.
    - `two_phase`: the energy of a membrane with a concentration, or `None`. Its moduli are in
      force then, and `bending_modulus` and `spontaneous_curvature`, the means of the two phases,
      are not.
    - `amount`: $\int c$, held, of a membrane with a concentration.
    """

    bending_modulus: Float[Array, ""]
    spontaneous_curvature: Float[Array, ""]
    area: Float[Array, ""]
    volume: Float[Array, ""]
    tension: Float[Array, ""]
    pressure: Float[Array, ""]
    global_energy: AbstractEnergy | None = None
    two_phase: TwoPhase | ScaledPhases | None = None
    amount: Float[Array, ""] | None = None


class Scaled(AbstractGlobalEnergy):
    r"""A global energy as a function of dimensionless numbers: $f(A L^2, V L^3, M L)/\kappa$."""

    energy: AbstractEnergy
    length: Float[Array, ""]
    kappa: Float[Array, ""]

    def of(self, A, V_p, M):
        L, value = self.length, jnp.zeros(())
        for factor, term in terms_of(self.energy):
            assert isinstance(term, AbstractGlobalEnergy)
            value = value + factor * term.of(A * L**2, V_p * L**3, M * L)
        return value / self.kappa


class Units(eqx.Module):
    r"""Length, $\kappa$ and origin that make a problem dimensionless; frozen numbers."""

    length: Float[Array, ""]
    kappa: Float[Array, ""]
    origin: Float[Array, "3"]

    def inward(self, x: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
        """Dimensionless nodes."""
        return (x - self.origin[None]) / self.length

    def outward(self, X: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
        """Nodes in the units of the user; the inverse of `inward`."""
        # A product of matrices is computed once. A product of numbers, fused with what follows, XLA
        # may compute twice with different rounding: the derivative of the largest coordinate would
        # find no node that has it.
        return self.origin[None] + X @ (self.length * jnp.eye(3))

    def parameters(self, p: Parameters) -> Parameters:
        """Dimensionless parameters; the modulus becomes $\\kappa$ in its unit."""
        L, kappa = self.length, self.kappa
        energy, phases = p.global_energy, p.two_phase
        assert not isinstance(phases, ScaledPhases)
        return Parameters(
            2 * p.bending_modulus / kappa,
            p.spontaneous_curvature * L,
            p.area / L**2,
            p.volume / L**3,
            p.tension * L**2 / kappa,
            p.pressure * L**3 / kappa,
            None if energy is None else Scaled(energy, L, kappa),
            None if phases is None else ScaledPhases(phases, L, kappa),
            None if p.amount is None else p.amount / L**2,
        )


def moduli(p: Parameters, c) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    r"""$\kappa$ and $H_0$ of dimensionless parameters, where the concentration is `c` if any."""
    if isinstance(p.two_phase, ScaledPhases):
        return p.two_phase.kappa_at(c), p.two_phase.curvature_at(c)
    return p.bending_modulus, p.spontaneous_curvature


def phases_of(p: Parameters) -> ScaledPhases:
    """The two-phase energy of dimensionless parameters that have one."""
    assert isinstance(p.two_phase, ScaledPhases)
    return p.two_phase

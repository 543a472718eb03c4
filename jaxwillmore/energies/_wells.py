r"""Double wells: free energies of mixing with two phases.

$\int\Psi(c) + \tfrac\gamma2|\nabla c|^2$ of an interface in equilibrium is, for a thin one, its
length times the line tension

$$ \lambda = \int_{c_-}^{c_+} \sqrt{2\gamma(\Psi - \Psi_t)}\,\mathrm dc $$

with the tangent $\Psi_t$ that touches $\Psi$ in both wells $c_\pm$.
"""

import abc
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..fem import Jet, inner
from ._parameters import finite, positive

Scalar = Float[Array, ""]

# Gauss points for λ: 1e-13 as long as the wells stand 1e-3 apart from 0 and 1.
_POINTS = 64
# From m = 1 Newton's method falls to the root; by 2/3 in a step where the wells are about to merge.
_NEWTON_STEPS = 60


class AbstractWell(eqx.Module):
    r"""A free energy density $\Psi$ with two wells and the coefficient $\gamma$ of the gradient.

    **Attributes:**

    - `gradient_coefficient`: $\gamma$, energy.
    - `line_tension`: $\lambda$ of a thin interface, energy/length.
    - `interface_width`: $\sqrt{\gamma/\Psi''}$ in the wells: how far $c$ feels an interface.
    """

    gradient_coefficient: eqx.AbstractVar[Scalar]
    line_tension: eqx.AbstractVar[Scalar]
    interface_width: eqx.AbstractVar[Scalar]

    @property
    @abc.abstractmethod
    def wells(self) -> tuple[Scalar, Scalar]:
        """The concentrations of the two phases, ascending."""

    @abc.abstractmethod
    def potential(self, c: Scalar) -> Scalar:
        r"""$\Psi(c)$, energy/length²."""

    @abc.abstractmethod
    def scaled(self, factor) -> "AbstractWell":
        r"""$\Psi$ and $\gamma$ times a factor."""

    def density(self, c: Jet) -> Scalar:
        r"""$\Psi(c) + \tfrac\gamma2|\nabla c|^2$ at one point, energy/length²."""
        return self.potential(c.value) + 0.5 * self.gradient_coefficient * inner(c.grad, c.grad)


class QuarticWell(AbstractWell):
    r"""$\Psi = \tfrac\zeta4 c^2(1 - c)^2$ by what it does: $\zeta = 12\lambda/\ell$,
    $\gamma = 6\lambda\ell$.

    The wells are 0 and 1; an interface in equilibrium has the profile $1/(1 + e^{-s/\ell})$, which
    goes from 10 % to 90 % over $4.39\,\ell$.

    **Arguments:**

    - `line_tension`: $\lambda$, energy/length.
    - `interface_width`: $\ell$, length.

    **Raises:** `ValueError` unless both are positive.
    """

    line_tension: Scalar
    interface_width: Scalar

    def __init__(self, line_tension, interface_width):
        self.line_tension = positive("line_tension", line_tension)
        self.interface_width = positive("interface_width", interface_width)

    @property
    def gradient_coefficient(self):
        return 6 * self.line_tension * self.interface_width

    @property
    def strength(self) -> Scalar:
        r"""$\zeta$, energy/length²."""
        return 12 * self.line_tension / self.interface_width

    @property
    def wells(self):
        return jnp.zeros(()), jnp.ones(())

    def potential(self, c):
        return 0.25 * self.strength * (c * (1 - c)) ** 2

    def scaled(self, factor):
        return QuarticWell(factor * self.line_tension, self.interface_width)


class FloryHuggins(AbstractWell):
    r"""$\Psi = \theta[c\ln c + (1-c)\ln(1-c)] + \omega c(1-c)$: ideal mixing and an interaction.

    Below `cutoff` and above 1 − `cutoff` it is continued by its Taylor polynomial of second order
    there: twice continuously differentiable, and finite for every $c$.

    **Arguments:**

    - `entropy_coefficient`: $\theta$, energy/length².
    - `interaction`: $\omega$, energy/length²; two phases need $\omega > 2\theta$.
    - `gradient_coefficient`: $\gamma$, energy.
    - `cutoff`: between 0 and the lower well.

    **Raises:** `ValueError` unless all are positive, $\omega > 2\theta$, and the cutoff lies below
    the well.
    """

    entropy_coefficient: Scalar
    interaction: Scalar
    gradient_coefficient: Scalar
    cutoff: Scalar

    def __init__(self, entropy_coefficient, interaction, gradient_coefficient, cutoff: Any = 1e-3):
        self.entropy_coefficient = positive("entropy_coefficient", entropy_coefficient)
        self.interaction = positive("interaction", interaction)
        self.gradient_coefficient = positive("gradient_coefficient", gradient_coefficient)
        self.cutoff = finite("cutoff", cutoff)
        numbers = self.entropy_coefficient, self.interaction, self.cutoff
        if any(isinstance(number, Tracer) for number in numbers):
            return
        theta, omega, low = map(float, numbers)
        if not omega > 2 * theta:
            raise ValueError(
                f"Two phases need `interaction` > 2 `entropy_coefficient` = {2 * theta:g}; "
                f"got {omega:g}."
            )
        # Below the lower well Ψ falls.
        falls = 0 < low < 0.5 and theta * math.log(low / (1 - low)) + omega * (1 - 2 * low) < 0
        if not falls:
            raise ValueError(
                f"`cutoff` must lie between 0 and the well at c = {float(self.wells[0]):.3g}; got "
                f"{low:g}."
            )

    def _mixing(self, c):
        entropy = c * jnp.log(c) + (1 - c) * jnp.log1p(-c)
        return self.entropy_coefficient * entropy + self.interaction * c * (1 - c)

    def potential(self, c):
        low, high = self.cutoff, 1 - self.cutoff
        # Before the logarithms: behind them a derivative would still be that of log(0).
        near = jnp.where(c < low, low, jnp.where(c > high, high, c))
        slope = jax.grad(self._mixing)
        beyond = c - near
        return self._mixing(near) + slope(near) * beyond + 0.5 * jax.grad(slope)(near) * beyond**2

    @property
    def wells(self):
        r"""Where $\Psi' = 0$: $c = (1 \mp m)/2$ with $m = \tanh(\omega m/2\theta) > 0$."""
        ratio = 0.5 * self.interaction / self.entropy_coefficient

        def newton(m, ratio):
            t = jnp.tanh(ratio * m)
            return m - (m - t) / (1 - ratio * (1 - t**2))

        fixed = jax.lax.stop_gradient(ratio)
        m = jax.lax.fori_loop(0, _NEWTON_STEPS, lambda _, m: newton(m, fixed), jnp.ones(()))
        # A step at the root has the derivatives of the root to first order, two to third order.
        m = newton(newton(m, ratio), ratio)
        return 0.5 * (1 - m), 0.5 * (1 + m)

    @property
    def line_tension(self):
        low, high = self.wells
        s, weights = np.polynomial.legendre.leggauss(_POINTS)
        c = low + 0.5 * (high - low) * jnp.asarray(1 + s)
        # The wells are symmetric, so the common tangent is level.
        height = jax.vmap(self.potential)(c) - self.potential(low)
        root = jnp.sqrt(2 * self.gradient_coefficient * height)
        return 0.5 * (high - low) * jnp.vdot(jnp.asarray(weights), root)

    @property
    def interface_width(self):
        low, high = self.wells
        return jnp.sqrt(
            self.gradient_coefficient
            / (self.entropy_coefficient / (low * high) - 2 * self.interaction)
        )

    def scaled(self, factor):
        return FloryHuggins(
            factor * self.entropy_coefficient,
            factor * self.interaction,
            factor * self.gradient_coefficient,
            self.cutoff,
        )

r"""A concentration on a surface: the energy of mixing, and the kinetics that lowers it.

The concentration $c$ is a density: its amount $\int c$ is carried by material points and changed by
its flux alone. For an energy $E(\Gamma, c)$ with the chemical potential $\mu = \delta E/\delta c$
and the normal force $V_c$ at $\partial^\bullet c = 0$,

$$ V = V_c + c\mu H + \dots, \qquad
   \partial^\bullet c = -cHV + \nabla_\Gamma\cdot(M\nabla_\Gamma\mu)
   \quad\text{or}\quad \partial^\bullet c = -cHV - \beta\mu $$

lower it: $\mathrm dE/\mathrm dt$ is $-\int V^2 - \int M|\nabla\mu|^2$, or $-\int V^2 -
\beta\int\mu^2$.
Both $\mu$ and $V_c$ are derivatives of one density of energy at a point, which JAX takes.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import GinzburgLandau, positive
from ..fem import Jet, inner, integrate, integrate_by_cell
from ..phases import amount, interface_length
from ..surface import area
from ._law import AbstractLaw, Field, Globals, Local, Statement, Whole

# The local error of a step lets c change by rtol over this weight: 0.04 for rtol = 2e-3.
ERROR_WEIGHT = 0.05
# The degenerate mobility never falls below this part of its largest value.
MOBILITY_FLOOR = 1e-3


def potential_equation(mu: Jet, slope: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$(\mu, \chi) = (\partial f/\partial c, \chi) + (\partial f/\partial\nabla c, \nabla\chi)$.

    For $f = \Psi + \tfrac\gamma2|\nabla c|^2 + \tfrac\kappa2 (H - H_0)^2 + b_k K$ that is
    $\mu = \Psi' - \gamma\Delta c + \tfrac12\kappa' e^2 - \kappa e H_0' + b_k' K$, $e = H - H_0$.
    """
    return mu.value * chi.value - slope.value * chi.value - inner(slope.grad, chi.grad)


def diffusion_equation(rate, mu: Jet, mobility, chi: Jet) -> Float[Array, ""]:
    r"""Cahn–Hilliard:  $\mathrm d(c, \chi)/\mathrm dt = -(M\nabla\mu, \nabla\chi)$."""
    return rate * chi.value + mobility * inner(mu.grad, chi.grad)


def relaxation_equation(rate, mu: Jet, mean, beta, chi: Jet) -> Float[Array, ""]:
    r"""Allen–Cahn:  $\mathrm d(c, \chi)/\mathrm dt = -\beta(\mu - \bar\mu, \chi)$."""
    return (rate + beta * (mu.value - mean)) * chi.value


def stress_force(f, slope: Jet, c: Jet, A, H) -> Float[Array, ""]:
    r"""$-f H + \partial f/\partial\nabla c\cdot A\nabla c$: the force of $\int f(c, \nabla c)$.

    At $\partial^\bullet c = 0$, where $\partial^\bullet\nabla c = -V A\nabla c$ within the surface.
    """
    return -f * H + inner(slope.grad, A @ c.grad)


class Mixing(AbstractLaw):
    r"""The energy $\int\Psi(c) + \tfrac\gamma2|\nabla c|^2$ and the force that it exerts.

    **Arguments:**

    - `energy`: a `GinzburgLandau` energy.
    """

    energy: GinzburgLandau

    def __init__(self, energy: GinzburgLandau):
        if not isinstance(energy, GinzburgLandau):
            raise ValueError(
                f"`energy` must be a `GinzburgLandau` energy; got {type(energy).__name__}."
            )
        self.energy = energy

    def statement(self):
        return Statement(
            reads=("c",),
            force=self._force,
            density=lambda s, c: self.energy.density(c),
            energy=self.energy,
            potential=lambda length: self.energy.well.line_tension / length,
        )

    def _force(self, s: Local):
        f, slope = jax.value_and_grad(self.energy.density)(s.hat.c)
        return stress_force(f, slope, s.hat.c, s.A, s.hat.H.value)


class CahnHilliard(AbstractLaw):
    r"""$\partial^\bullet c = -cHV + \nabla_\Gamma\cdot(M\nabla_\Gamma\mu)$: the amount stays.

    **Arguments:**

    - `mobility`: $M$, length⁶/(energy·time), for a concentration per area without unit:
      length⁴/(energy·time).
    - `degenerate`: $M(c) = M\,4c(1-c)$, with a floor of 1e-3 M, in place of the constant.

    **Raises:** `ValueError` for a mobility that is not positive; in a `System`, without an energy
    that depends on $c$.
    """

    mobility: Float[Array, ""]
    degenerate: bool

    def __init__(self, mobility=1.0, degenerate: bool = False):
        self.mobility = positive("mobility", mobility)
        self.degenerate = bool(degenerate)

    def statement(self):
        return Statement(
            fields=concentration_fields(self._conservation),
            stages=(("c", "mu"),),
            start=given_concentration,
            needs_density=True,
            force=lambda s: s.hat.c.value * s.hat.mu.value * s.hat.H.value,
            diffusion_time=lambda length, potential: length**2 / (self.mobility * potential),
            record=self._record,
            activity=self._activity,
            implicit_only=True,
        )

    def mobility_at(self, c) -> Float[Array, ""]:
        """M at a concentration."""
        if not self.degenerate:
            return self.mobility
        return self.mobility * jnp.maximum(4 * c * (1 - c), MOBILITY_FLOOR)

    def _conservation(self, s: Local, chi: Jet):
        M = self.mobility_at(s.trial.c.value)
        return diffusion_equation(s.rate.c, s.trial.mu, M, chi)

    def _record(self, s: Whole):
        density = lambda _, f: self.mobility_at(f.c.value) * inner(f.mu.grad, f.mu.grad)
        fields = {"c": s.fields["c"], "mu": s.fields["mu"]}
        return concentration_record(s) | {
            "phase_dissipation": integrate(s.mesh, s.x, density, fields)
        }

    def _activity(self, s: Whole):
        r"""The largest $|\nabla\mu|$ over that of the typical potential on the surface."""

        def density(_, f):
            return jnp.stack([inner(f.mu.grad, f.mu.grad), jnp.ones(())])

        sums = integrate_by_cell(s.mesh, s.x, density, {"mu": s.fields["mu"]})
        return jnp.sqrt(jnp.max(sums[:, 0] / sums[:, 1])) * s.units.length / s.units.potential


class AllenCahn(AbstractLaw):
    r"""$\partial^\bullet c = -cHV - \beta(\mu - \bar\mu)$: relaxation in place of diffusion.

    **Arguments:**

    - `kinetic_coefficient`: $\beta$, length²/(energy·time).
    - `held_amount`: hold the amount $\int c$ of the start by the exchange potential $\bar\mu$, a
      global unknown; otherwise $\bar\mu = 0$ and the amount changes.

    **Raises:** `ValueError` for a coefficient that is not positive; in a `System`, without an
    energy that depends on $c$.
    """

    kinetic_coefficient: Float[Array, ""]
    held_amount: bool

    def __init__(self, kinetic_coefficient=1.0, held_amount: bool = False):
        self.kinetic_coefficient = positive("kinetic_coefficient", kinetic_coefficient)
        self.held_amount = bool(held_amount)

    def statement(self):
        return Statement(
            fields=concentration_fields(self._relaxation),
            stages=(("c", "mu"),),
            start=given_concentration,
            needs_density=True,
            force=lambda s: s.hat.c.value * s.hat.mu.value * s.hat.H.value,
            globals=self._exchange() if self.held_amount else None,
            diffusion_time=lambda length, potential: 1 / (self.kinetic_coefficient * potential),
            record=self._record,
            activity=self._activity,
            implicit_only=True,
        )

    def _mean(self, multipliers):
        return multipliers.exchange_potential if self.held_amount else jnp.zeros(())

    def _relaxation(self, s: Local, chi: Jet):
        mean = self._mean(s.multipliers)
        return relaxation_equation(s.rate.c, s.trial.mu, mean, self.kinetic_coefficient, chi)

    def _exchange(self) -> Globals:
        r"""$\int(\mu - \bar\mu) = 0$, which with the conservative step holds $\int c$."""

        def closures(s: Whole):
            excess = s.fields["mu"] - s.multipliers.exchange_potential
            size = s.units.length**2 * s.units.potential
            return (amount(s.mesh, s.x, excess) / size)[None]

        return Globals(("exchange_potential",), closures, lambda u: u.potential[None])

    def _record(self, s: Whole):
        density = lambda _, f: (
            self.kinetic_coefficient * (f.mu.value - self._mean(s.multipliers)) ** 2
        )
        return concentration_record(s) | {
            "phase_dissipation": integrate(s.mesh, s.x, density, {"mu": s.fields["mu"]})
        }

    def _activity(self, s: Whole):
        excess = s.fields["mu"] - self._mean(s.multipliers)
        return jnp.max(jnp.abs(excess)) / s.units.potential


def concentration_fields(conservation) -> tuple[Field, Field]:
    """c with its conservation law, and μ as the derivative of the energy of all laws."""

    def potential(s: Local, chi: Jet):
        return potential_equation(s.trial.mu, jax.grad(s.density)(s.trial.c), chi)

    one = lambda u: jnp.ones(())
    return (
        Field("c", conservation, one, role="conserved", error_weight=ERROR_WEIGHT),
        Field("mu", potential, lambda u: u.potential),
    )


def given_concentration(mesh, x, given):
    """c at the start, which nothing but the caller knows."""
    if "c" not in given:
        raise ValueError(
            'The concentration needs a start: initial={"c": ...}, one number for every node; '
            "`jaxwillmore.phases` makes stripes, caps and noise."
        )
    return {"c": given["c"]}


def concentration_record(s: Whole) -> dict[str, Float[Array, ""]]:
    """Amount, extremes and length of the line c = ½."""
    c = s.fields["c"]
    total = amount(s.mesh, s.x, c)
    return {
        "phase_amount": total,
        "phase_mean": total / area(s.mesh, s.x),
        "phase_smallest": jnp.min(c),
        "phase_largest": jnp.max(c),
        "phase_interface_length": interface_length(s.mesh, s.x, c),
    }

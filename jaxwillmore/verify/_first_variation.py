r"""First variations of the energies, as in the literature, at one point of a surface.

They serve as an oracle: no flow and no derivative of the package is made from them. For a
direction $\phi = V\nu + T$

$$ \mathrm{d}E(\phi) = \int_\Gamma g\,V + q\cdot\nabla_\Gamma V \qquad
   \text{with } (g, q) \text{ from } \texttt{first\_variation}. $$

Tangential motion T changes no energy of the shape alone; it does change the energy of a field
that is carried along, see `CarriedLineEnergy`.
"""

import functools as ft
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import (
    AbstractEnergy,
    AbstractGlobalEnergy,
    CanhamHelfrich,
    Willmore,
    terms_of,
)
from ..energies._base import Combination
from ..fem import Jet, inner, integrate
from ..surface import gaussian_curvature


def _number(value) -> Float[Array, ""]:
    return jnp.asarray(value, float)


class Geometry(eqx.Module):
    """A surface at one point: mean curvature with gradient, Weingarten map, a carried field."""

    H: Jet
    A: Float[Array, "3 3"]
    c: Jet


class Whole(NamedTuple):
    """A surface as a whole: area, volume, total mean curvature."""

    area: Float[Array, ""]
    volume: Float[Array, ""]
    total_mean_curvature: Float[Array, ""]


class FirstVariation(NamedTuple):
    """Force density $g$, energy/length³, and flux $q$, energy/length²."""

    force: Float[Array, ""]
    flux: Float[Array, "3"]


class CarriedLineEnergy(AbstractEnergy):
    r"""$E = \int \tfrac\zeta4 c^2(1-c)^2 + \tfrac\gamma2|\nabla_\Gamma c|^2$ of a carried field.

    The nodal values `c` stay when nodes move: $\partial^\bullet c = 0$.
    """

    c: Float[Array, " nodes"]
    gradient_coefficient: Float[Array, ""] = eqx.field(default=0.3, converter=_number)
    well: Float[Array, ""] = eqx.field(default=2.0, converter=_number)

    def potential(self, c: Float[Array, ""]) -> Float[Array, ""]:
        r"""$\Psi(c)$, energy/length²."""
        return 0.25 * self.well * c**2 * (1 - c) ** 2

    def density(self, c: Jet) -> Float[Array, ""]:
        r"""$\Psi(c) + \tfrac\gamma2|\nabla_\Gamma c|^2$, energy/length²."""
        return self.potential(c.value) + 0.5 * self.gradient_coefficient * inner(c.grad, c.grad)

    def by_field(self, c: Jet, change: Jet) -> Float[Array, ""]:
        r"""$\Psi'(c)\,\delta c + \gamma\nabla_\Gamma c\cdot\nabla_\Gamma\delta c$ at one point."""
        slope = jax.grad(self.potential)(c.value)
        return slope * change.value + self.gradient_coefficient * inner(c.grad, change.grad)

    def __call__(self, mesh, x, fields=None):
        return integrate(mesh, x, lambda _, f: self.density(f.c), {"c": self.c})


@ft.singledispatch
def first_variation(energy, at: Geometry, whole: Whole) -> FirstVariation:
    r"""Force and flux $(g, q)$ of an energy at one point; one function per kind of energy.

    A new kind is taught with `@first_variation.register(NewEnergy)`.

    **Raises:** `ValueError` for an energy whose formula is not known.
    """
    raise ValueError(f"There is no formula for the first variation of {type(energy).__name__}.")


@first_variation.register(Willmore)
def willmore(energy: Willmore, at: Geometry, whole: Whole) -> FirstVariation:
    r"""$\int (-\Delta H + \tfrac12H^3 - H|A|^2)V$, by parts."""
    H, A = at.H.value, at.A
    return FirstVariation(0.5 * H**3 - H * inner(A, A), at.H.grad)


@first_variation.register(CanhamHelfrich)
def canham_helfrich(energy: CanhamHelfrich, at: Geometry, whole: Whole) -> FirstVariation:
    r"""$-2b_b\int [\Delta H + |A|^2(H - H_0) - \tfrac12H(H - H_0)^2]V$, by parts.

    The Gaussian modulus adds nothing on a closed surface.
    """
    b, H0 = 2 * energy.bending_modulus, energy.spontaneous_curvature
    H, A = at.H.value, at.A
    force = b * (0.5 * H * (H - H0) ** 2 - inner(A, A) * (H - H0))
    return FirstVariation(force, b * at.H.grad)


@first_variation.register(AbstractGlobalEnergy)
def of_measures(energy: AbstractGlobalEnergy, at: Geometry, whole: Whole) -> FirstVariation:
    r"""$\int (\partial_Af\,H + \partial_Vf + 2\,\partial_Mf\,K)V$ for $f(A, V_p, M)$, $M = \int H$.

    Tension: $\sigma H$; pressure: $-P$; osmosis: $-iRT(n/V_p - \bar c)$; area difference: the rest.
    """
    by_area, by_volume, by_curvature = jax.grad(energy.of, argnums=(0, 1, 2))(*whole)
    K = gaussian_curvature(at.A)
    force = by_area * at.H.value + by_volume + 2 * by_curvature * K
    return FirstVariation(force, jnp.zeros(3))


@first_variation.register(CarriedLineEnergy)
def line_energy(energy: CarriedLineEnergy, at: Geometry, whole: Whole) -> FirstVariation:
    r"""$\int [(\Psi + \tfrac\gamma2|\nabla c|^2)H - \gamma\,\nabla c\cdot A\nabla c]V$."""
    gradient = at.c.grad
    stretch = energy.density(at.c) * at.H.value
    turn = energy.gradient_coefficient * inner(gradient, at.A @ gradient)
    return FirstVariation(stretch - turn, jnp.zeros(3))


@first_variation.register(Combination)
def of_sum(energy: Combination, at: Geometry, whole: Whole) -> FirstVariation:
    """The same combination of the variations of the terms."""
    force, flux = jnp.zeros(()), jnp.zeros(3)
    for factor, term in terms_of(energy):
        part = first_variation(term, at, whole)
        force, flux = force + factor * part.force, flux + factor * part.flux
    return FirstVariation(force, flux)

r"""First variations of the energies, as in the literature, at one point of a surface.

They serve as an oracle: no flow and no derivative of the package is made from them. For a
direction $\phi = V\nu + T$

$$ \mathrm{d}E(\phi) = \int_\Gamma g\,V + q\cdot\nabla_\Gamma V \qquad
   \text{with } (g, q) \text{ from } \texttt{first\_variation}. $$

Tangential motion T changes no energy of the shape alone. An energy that reads a concentration also
has a derivative by it, and T, which carries the nodal values along, changes that energy by it:

$$ \mathrm{d}E(\psi) = \int_\Gamma \mu\,\psi \qquad
   \text{in weak form from } \texttt{concentration\_variation}. $$
"""

import functools as ft
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import (
    AbstractGlobalEnergy,
    CanhamHelfrich,
    Combination,
    GinzburgLandau,
    TwoPhase,
    Willmore,
    modulus_at,
    modulus_jet,
    terms_of,
)
from ..fem import Jet, inner
from ..surface import gaussian_curvature


class Geometry(eqx.Module):
    """A surface at one point: mean curvature with gradient, Weingarten map, concentration."""

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
    r"""$-\int [\Delta U + |A|^2U - b_bH(H - H_0)^2 + \nabla\cdot((HI - A)\nabla b_k)]V$, by parts.

    With $U = 2b_b(H - H_0)$; the moduli may depend on the concentration, which stays on its points.
    A constant Gaussian modulus adds nothing on a closed surface.
    """
    b_b, H0, b_k = (modulus_jet(modulus, at.c) for modulus in _moduli(energy))
    H, A, e = at.H.value, at.A, at.H.value - H0.value
    force = b_b.value * (H * e**2 - 2 * inner(A, A) * e)
    of_U = 2 * (b_b.value * (at.H.grad - H0.grad) + e * b_b.grad)
    return FirstVariation(force, of_U + H * b_k.grad - A @ b_k.grad)


@first_variation.register(AbstractGlobalEnergy)
def of_measures(energy: AbstractGlobalEnergy, at: Geometry, whole: Whole) -> FirstVariation:
    r"""$\int (\partial_Af\,H + \partial_Vf + 2\,\partial_Mf\,K)V$ for $f(A, V_p, M)$, $M = \int H$.

    Tension: $\sigma H$; pressure: $-P$; osmosis: $-iRT(n/V_p - \bar c)$; area difference: the rest.
    """
    by_area, by_volume, by_curvature = jax.grad(energy.of, argnums=(0, 1, 2))(*whole)
    K = gaussian_curvature(at.A)
    force = by_area * at.H.value + by_volume + 2 * by_curvature * K
    return FirstVariation(force, jnp.zeros(3))


@first_variation.register(GinzburgLandau)
def ginzburg_landau(energy: GinzburgLandau, at: Geometry, whole: Whole) -> FirstVariation:
    r"""$\int [(\Psi + \tfrac\gamma2|\nabla c|^2)H - \gamma\,\nabla c\cdot A\nabla c]V$."""
    gradient = at.c.grad
    stretch = energy.density(at.c) * at.H.value
    turn = energy.well.gradient_coefficient * inner(gradient, at.A @ gradient)
    return FirstVariation(stretch - turn, jnp.zeros(3))


@first_variation.register(TwoPhase)
def two_phase(energy: TwoPhase, at: Geometry, whole: Whole) -> FirstVariation:
    """The sum of those of its bending and its mixing."""
    bending, mixing = (first_variation(e, at, whole) for e in (energy.bending, energy.mixing))
    return FirstVariation(bending.force + mixing.force, bending.flux + mixing.flux)


@first_variation.register(Combination)
def of_sum(energy: Combination, at: Geometry, whole: Whole) -> FirstVariation:
    """The same combination of the variations of the terms."""
    force, flux = jnp.zeros(()), jnp.zeros(3)
    for factor, term in terms_of(energy):
        part = first_variation(term, at, whole)
        force, flux = force + factor * part.force, flux + factor * part.flux
    return FirstVariation(force, flux)


@ft.singledispatch
def concentration_variation(energy, at: Geometry, change: Jet) -> Float[Array, ""]:
    r"""$\mu\psi$ at one point, by parts, for a change $\psi$ of the concentration; energy/length².

    Zero for an energy that reads no concentration.
    """
    return jnp.zeros(())


@concentration_variation.register(CanhamHelfrich)
def of_moduli(energy: CanhamHelfrich, at: Geometry, change: Jet) -> Float[Array, ""]:
    r"""$[b_b'(H - H_0)^2 - 2b_b(H - H_0)H_0' + b_k'K]\psi$."""
    c = at.c.value
    b_b, H0 = (modulus_at(modulus, c) for modulus in _moduli(energy)[:2])
    by_c = [jax.grad(ft.partial(modulus_at, modulus))(c) for modulus in _moduli(energy)]
    e, K = at.H.value - H0, gaussian_curvature(at.A)
    return (by_c[0] * e**2 - 2 * b_b * e * by_c[1] + by_c[2] * K) * change.value


@concentration_variation.register(GinzburgLandau)
def of_mixing(energy: GinzburgLandau, at: Geometry, change: Jet) -> Float[Array, ""]:
    r"""$\Psi'(c)\,\psi + \gamma\nabla c\cdot\nabla\psi$."""
    slope = jax.grad(energy.well.potential)(at.c.value)
    steep = energy.well.gradient_coefficient * inner(at.c.grad, change.grad)
    return slope * change.value + steep


@concentration_variation.register(TwoPhase)
def of_two_phases(energy: TwoPhase, at: Geometry, change: Jet) -> Float[Array, ""]:
    """The sum of those of its bending and its mixing."""
    parts = (concentration_variation(e, at, change) for e in (energy.bending, energy.mixing))
    return sum(parts, start=jnp.zeros(()))


def _moduli(energy: CanhamHelfrich) -> tuple[Any, Any, Any]:
    """Bending modulus, spontaneous curvature, Gaussian modulus."""
    return energy.bending_modulus, energy.spontaneous_curvature, energy.gaussian_modulus

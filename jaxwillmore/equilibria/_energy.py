"""A sum of energies, taken apart into what bends, what mixes, and energies of the whole surface."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import (
    AbstractEnergy,
    AbstractGlobalEnergy,
    AbstractModulus,
    CanhamHelfrich,
    GinzburgLandau,
    TwoPhase,
    Willmore,
    finite,
    modulus_at,
    positive,
    terms_of,
)


class Parts(NamedTuple):
    """What a sum of energies is made of.

    With a two-phase energy, modulus and curvature are the means of its phases.
    """

    bending_modulus: Float[Array, ""]
    spontaneous_curvature: Float[Array, ""]
    global_energy: AbstractEnergy | None
    two_phase: TwoPhase | None


def split(energy: AbstractEnergy | None, bending_modulus, spontaneous_curvature) -> Parts:
    """The parts of an energy.

    **Raises:** `ValueError` unless there is at most one bending energy and one of mixing, and
    everything else is global; when modulus or curvature are said twice; for moduli that depend on
    a concentration without an energy of mixing, or that are nodal fields.
    """
    bending, mixing, rest = [], [], []
    for factor, term in [] if energy is None else terms_of(energy):
        if isinstance(term, CanhamHelfrich | Willmore | TwoPhase):
            bending.append((factor, _bending_of(term)))
        if isinstance(term, GinzburgLandau | TwoPhase):
            part = term.mixing if isinstance(term, TwoPhase) else term
            mixing.append(part.scaled(factor))
        elif isinstance(term, AbstractGlobalEnergy):
            rest.append(factor * term)
        elif not isinstance(term, CanhamHelfrich | Willmore):
            raise ValueError(
                "`energy` must be a sum of one CanhamHelfrich (or Willmore) energy, or one "
                "TwoPhase energy, and global energies; "
                f"{type(term).__name__} is none of them."
            )
    if len(bending) > 1:
        raise ValueError(f"`energy` must hold one bending energy; got {len(bending)}.")
    if len(mixing) > 1:
        raise ValueError(f"`energy` must hold one energy of mixing; got {len(mixing)}.")
    if bending and not (bending_modulus is None and spontaneous_curvature is None):
        raise ValueError(
            "`energy` has a bending energy: leave out `bending_modulus` and "
            "`spontaneous_curvature`, or take it out of the sum."
        )
    total = None
    for term in rest:
        total = term if total is None else total + term
    b_b, H0, b_k = 0.5, 0.0, 0.0
    if bending:
        factor, (b_b, H0, b_k) = bending[0]
        b_b, b_k = _times(factor, b_b), _times(factor, b_k)
    else:
        b_b = b_b if bending_modulus is None else bending_modulus
        H0 = H0 if spontaneous_curvature is None else spontaneous_curvature
    if not mixing:
        if any(isinstance(modulus, AbstractModulus) for modulus in (b_b, H0, b_k)):
            raise ValueError(
                "Moduli that depend on a concentration need an energy of mixing: "
                "take a TwoPhase energy."
            )
        return Parts(
            positive("bending_modulus", b_b), finite("spontaneous_curvature", H0), total, None
        )
    for name, modulus in (("bending_modulus", b_b), ("spontaneous_curvature", H0)):
        _refuse_nodal(name, modulus)
    _refuse_nodal("gaussian_modulus", b_k)
    well = mixing[0].well
    phases = TwoPhase(b_b, H0, b_k, well=well)
    mean_b, mean_H0 = (sum(modulus_at(modulus, c) for c in well.wells) / 2 for modulus in (b_b, H0))
    return Parts(positive("bending_modulus", mean_b), jnp.asarray(mean_H0), total, phases)


def _bending_of(term):
    """Bending modulus, spontaneous curvature and Gaussian modulus of an energy that bends."""
    if isinstance(term, Willmore):
        return 0.5, 0.0, 0.0
    part = term.bending if isinstance(term, TwoPhase) else term
    return part.bending_modulus, part.spontaneous_curvature, part.gaussian_modulus


def _times(factor, modulus):
    return modulus.scaled(factor) if isinstance(modulus, AbstractModulus) else factor * modulus


def _refuse_nodal(name: str, modulus) -> None:
    if not isinstance(modulus, AbstractModulus) and jnp.ndim(modulus):
        raise ValueError(
            f"`{name}` must be a number or a function of the concentration for an equilibrium; got "
            f"an array of shape {jnp.shape(modulus)}: the nodes of the mesh move over the material."
        )

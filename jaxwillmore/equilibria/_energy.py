"""A sum of energies, taken apart into the bending energy and the energies of the whole surface."""

from ..energies import (
    AbstractEnergy,
    AbstractGlobalEnergy,
    CanhamHelfrich,
    Willmore,
    finite,
    positive,
    terms_of,
)


def split(energy: AbstractEnergy | None, bending_modulus, spontaneous_curvature):
    """Bending modulus, spontaneous curvature and the global part (or `None`) of an energy.

    **Raises:** `ValueError` unless there is at most one bending energy and everything else is
    global, or when modulus or curvature are said twice.
    """
    bending, rest = [], []
    for factor, term in [] if energy is None else terms_of(energy):
        if isinstance(term, CanhamHelfrich):
            bending.append((factor * term.bending_modulus, term.spontaneous_curvature))
        elif isinstance(term, Willmore):
            bending.append((0.5 * factor, 0.0))
        elif isinstance(term, AbstractGlobalEnergy):
            rest.append(factor * term)
        else:
            raise ValueError(
                "`energy` must be a sum of one CanhamHelfrich (or Willmore) energy and global "
                f"energies; {type(term).__name__} is neither."
            )
    if len(bending) > 1:
        raise ValueError(f"`energy` must hold one bending energy; got {len(bending)}.")
    if bending and not (bending_modulus is None and spontaneous_curvature is None):
        raise ValueError(
            "`energy` has a bending energy: leave out `bending_modulus` and "
            "`spontaneous_curvature`, or take it out of the sum."
        )
    given = (
        0.5 if bending_modulus is None else bending_modulus,
        0.0 if spontaneous_curvature is None else spontaneous_curvature,
    )
    b, H0 = bending[0] if bending else given
    total = None
    for term in rest:
        total = term if total is None else total + term
    return positive("bending_modulus", b), finite("spontaneous_curvature", H0), total

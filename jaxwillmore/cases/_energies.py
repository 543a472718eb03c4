"""The energies of the whole surface that a case asks for."""

from ..energies import (
    AbstractEnergy,
    AreaDifference,
    AreaPenalty,
    CanhamHelfrich,
    OsmoticPressure,
    Pressure,
    SurfaceTension,
    VolumePenalty,
)
from ..mesh import SurfaceMesh
from ..surface import area, volume
from ._case import Case
from ._keys import values


def bending_energy(case: Case) -> CanhamHelfrich:
    """∫ b (H − H0)² of one phase, without the constant of the Gaussian curvature."""
    energy = case.energy
    return CanhamHelfrich(
        energy.bending_modulus, spontaneous_curvature=energy.spontaneous_curvature
    )


def global_energy(case: Case, mesh: SurfaceMesh, x, loads: bool = True) -> AbstractEnergy | None:
    """The sum of the energies of area, volume and total mean curvature, or `None`.

    **Arguments:**

    - `mesh`, `x`: the start, whose area and volume `"initial"` means.
    - `loads`: with the work of tension and pressure.
    """
    energy, terms = case.energy, []
    if loads and energy.tension:
        terms.append(SurfaceTension(energy.tension))
    if loads and energy.pressure:
        terms.append(Pressure(energy.pressure))
    if energy.osmotic is not None:
        terms.append(OsmoticPressure(**values(energy.osmotic)))
    if energy.area_difference is not None:
        terms.append(AreaDifference(**values(energy.area_difference)))
    if energy.area_penalty is not None:
        preferred = energy.area_penalty.preferred_area
        preferred = float(area(mesh, x)) if preferred == "initial" else preferred
        terms.append(AreaPenalty(energy.area_penalty.stretching_modulus, preferred))
    if energy.volume_penalty is not None:
        preferred = energy.volume_penalty.preferred_volume
        preferred = float(volume(mesh, x)) if preferred == "initial" else preferred
        terms.append(VolumePenalty(energy.volume_penalty.strength, preferred))
    total = None
    for term in terms:
        total = term if total is None else total + term
    return total

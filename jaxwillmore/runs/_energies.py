"""The energies of the whole surface that a case asks for."""

from ..cases import Case
from ..energies import AbstractEnergy, CanhamHelfrich, Pressure, SurfaceTension
from ..mesh import SurfaceMesh


def bending_energy(case: Case) -> CanhamHelfrich:
    """∫ b_b (H − H0)² of one phase, without the constant of the Gaussian curvature."""
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
    terms += [section.energy(mesh, x) for section in energy.sections()]
    total = None
    for term in terms:
        total = term if total is None else total + term
    return total

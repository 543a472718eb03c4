"""The flow that lowers an energy."""

from functools import reduce
from operator import add

from ..energies import (
    AbstractEnergy,
    AbstractGlobalEnergy,
    AbstractModulus,
    CanhamHelfrich,
    ExternalPotential,
    GinzburgLandau,
    TwoPhase,
    Willmore,
    terms_of,
)
from ._helfrich import HelfrichFlow
from ._law import AbstractLaw
from ._loads import Loads
from ._motion import NoDrift
from ._phase import AllenCahn, CahnHilliard, Mixing
from ._system import System
from ._tangential import MinimalDeformation
from ._willmore import WillmoreFlow

TANGENTIAL = {"none": None, "minimal-deformation": MinimalDeformation}


def gradient_flow(
    energy: AbstractEnergy,
    *,
    phase: CahnHilliard | AllenCahn | None = None,
    area=None,
    volume=None,
    tangential: str = "none",
    hold_drift: bool | None = None,
    consistency=6.0,
    consistency_weight="global",
) -> System:
    r"""The gradient flow of a sum of energies: L² for the surface, L² or H⁻¹ for a concentration.

    **Arguments:**

    - `energy`: a sum with one bending energy (`Willmore`, `CanhamHelfrich`, `TwoPhase`), at most
      one energy of mixing (`TwoPhase`, `GinzburgLandau`), and any number of global energies
      (`SurfaceTension`, `OsmoticPressure`, ...) and of `ExternalPotential`. Without a bending
      energy, a `GinzburgLandau` energy alone: the surface is at rest.
    - `phase`: the kinetics of the concentration, `CahnHilliard` or `AllenCahn`; needed where the
      energy depends on one.
    - `area`, `volume`: held exactly, as in `Loads`.
    - `tangential`: `"none"`: nodes move with $V\nu$; `"minimal-deformation"`: `MinimalDeformation`.
    - `hold_drift`: add `NoDrift`; by default where moduli depend on the concentration.
    - `consistency`, `consistency_weight`: as in `WillmoreFlow`.

    **Returns:**

    A `System` of laws: `WillmoreFlow` where all parameters of the bending energy are numbers, else
    `HelfrichFlow`; `Mixing` and the kinetics; `Loads` where there is a load or a constraint. A
    constant $b_k$ adds $2\pi\chi\,b_k$ to the energy and no force; `WillmoreFlow` does not count
    it.

    **Raises:** `ValueError` for an energy that has no flow here (a `Density`, or one of your own),
    for none or several bending energies, for one with a negative factor, and for an energy of a
    concentration without kinetics, or kinetics without such an energy.

    ```python
    energy = jw.energies.TwoPhase(
        bending_modulus=jw.energies.Mixture(0.5, 1.0), line_tension=4.0, interface_width=0.15
    )
    flow = jw.flows.gradient_flow(
        energy, phase=jw.flows.CahnHilliard(), area=A, volume=V, tangential="minimal-deformation"
    )
    solution = jw.evolve.evolve(flow, mesh, x, t1=1.0, initial={"c": c})
    ```
    """
    if tangential not in TANGENTIAL:
        raise ValueError(f"`tangential` must be one of {tuple(TANGENTIAL)}; got {tangential!r}.")
    bending, mixing, loads = _sorted(energy)
    if (mixing is None) != (phase is None):
        have, lack = ("mixing", "phase=CahnHilliard() or phase=AllenCahn()")
        if mixing is None:
            have, lack = "kinetics", "an energy of mixing, `TwoPhase` or `GinzburgLandau`"
        raise ValueError(f"A flow with {have} of a concentration also needs {lack}.")
    laws: list[AbstractLaw] = [] if mixing is None else [phase, Mixing(mixing)]  # pyright: ignore
    held = area is not None or volume is not None
    if bending is None:
        if loads or held or tangential != "none":
            raise ValueError(
                "Loads, constraints and a tangential motion need a surface that moves, and without "
                "a bending energy it is at rest. Add `Willmore` or `CanhamHelfrich`; for area "
                "alone see `MeanCurvatureFlow`."
            )
        return System(*laws)
    factor, term = bending
    laws.append(_bending_law(factor, term, consistency, consistency_weight))
    if loads or held:
        laws.append(Loads(reduce(add, loads) if loads else None, area=area, volume=volume))
    mixed = any(callable(p) for p in _parameters(term))
    if mixed if hold_drift is None else hold_drift:
        laws.append(NoDrift())
    motion = TANGENTIAL[tangential]
    return System(*laws) if motion is None else System(*laws, motion())


def _sorted(energy):
    """The bending energy with its factor, the energy of mixing, and the loads."""
    bending, mixing, loads = [], [], []
    for factor, term in terms_of(energy):
        if isinstance(term, Willmore | CanhamHelfrich | TwoPhase):
            bending.append((factor, term))
        if isinstance(term, TwoPhase | GinzburgLandau):
            mixing.append((factor, term))
        if isinstance(term, AbstractGlobalEnergy | ExternalPotential):
            loads.append(factor * term)
        elif not isinstance(term, Willmore | CanhamHelfrich | TwoPhase | GinzburgLandau):
            raise ValueError(
                f"{type(term).__name__} has no flow here: its first variation is not in a weak "
                "form. Minimise it as a function of the nodes, or write a law for it."
            )
    alone = mixing and not any(isinstance(term, TwoPhase) for _, term in mixing)
    if len(bending) > 1 or (not bending and not alone) or len(mixing) > 1:
        raise ValueError(
            "A gradient flow needs one bending energy (`Willmore`, `CanhamHelfrich` or `TwoPhase`) "
            f"and at most one energy of mixing; the sum has {len(bending)} and {len(mixing)}. Add "
            "the moduli of several; for area alone see `MeanCurvatureFlow`."
        )
    return bending[0] if bending else None, _mixing(*mixing[0]) if mixing else None, loads


def _mixing(factor, term) -> GinzburgLandau:
    mixing = term.mixing if isinstance(term, TwoPhase) else term
    return mixing.scaled(factor)


def _parameters(term) -> tuple:
    if isinstance(term, Willmore):
        return ()
    bending = term.bending if isinstance(term, TwoPhase) else term
    return bending.bending_modulus, bending.spontaneous_curvature, bending.gaussian_modulus


def _bending_law(factor, term, consistency, weight) -> AbstractLaw:
    if isinstance(term, Willmore):
        return WillmoreFlow(0.5 * factor, 0.0, consistency, weight)
    b_b, H0, b_k = _parameters(term)
    numbers = all(not callable(p) and p.ndim == 0 for p in (b_b, H0, b_k))
    if numbers:
        return WillmoreFlow(factor * b_b, H0, consistency, weight)
    return HelfrichFlow(_times(factor, b_b), H0, _times(factor, b_k), consistency, weight)


def _times(factor, parameter):
    is_function = isinstance(parameter, AbstractModulus)
    return parameter.scaled(factor) if is_function else factor * parameter

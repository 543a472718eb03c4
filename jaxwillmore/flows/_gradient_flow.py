"""The flow that lowers an energy."""

from functools import reduce
from operator import add

from ..energies import (
    AbstractEnergy,
    AbstractGlobalEnergy,
    CanhamHelfrich,
    ExternalPotential,
    Willmore,
    terms_of,
)
from ._base import AbstractFlow
from ._helfrich import HelfrichFlow
from ._loaded import Loaded
from ._willmore import WillmoreFlow


def gradient_flow(
    energy: AbstractEnergy,
    *,
    fixed_area=None,
    fixed_volume=None,
    consistency=6.0,
    consistency_weight="global",
) -> AbstractFlow:
    r"""The L² gradient flow $V = -\delta E/\delta\nu$ of a bending energy with loads.

    **Arguments:**

    - `energy`: a sum with one bending energy (`Willmore` or `CanhamHelfrich`) and any number of
      global energies (`SurfaceTension`, `OsmoticPressure`, ...) and of `ExternalPotential`.
    - `fixed_area`, `fixed_volume`: held exactly, as in `Loaded`.
    - `consistency`, `consistency_weight`: as in `WillmoreFlow`.

    **Returns:**

    `WillmoreFlow` where all parameters are numbers, else `HelfrichFlow`; inside `Loaded` where
    there is a load or a constraint. A constant $b_k$ adds $2\pi\chi\,b_k$ to the energy and no
    force; `WillmoreFlow` does not count it.

    **Raises:** `ValueError` for an energy that has no flow here (a `Density`, or one of your own),
    for none or several bending energies, and for one with a negative factor.

    ```python
    energy = jw.energies.CanhamHelfrich(0.5, spontaneous_curvature=0.5) + jw.energies.Pressure(0.1)
    solution = jw.evolve.evolve(jw.flows.gradient_flow(energy), mesh, x, t1=1.0)
    ```
    """
    bending, loads = [], []
    for factor, term in terms_of(energy):
        if isinstance(term, Willmore | CanhamHelfrich):
            bending.append((factor, term))
        elif isinstance(term, AbstractGlobalEnergy | ExternalPotential):
            loads.append(factor * term)
        else:
            raise ValueError(
                f"{type(term).__name__} has no flow here: its first variation is not in a weak "
                "form. Minimise it as a function of the nodes, or write an `AbstractFlow` for it."
            )
    if len(bending) != 1:
        raise ValueError(
            "A gradient flow needs one bending energy, `Willmore` or `CanhamHelfrich`; the sum has "
            f"{len(bending)}. Add the moduli of several; for area alone see `MeanCurvatureFlow`."
        )
    factor, term = bending[0]
    flow = _bending_flow(factor, term, consistency, consistency_weight)
    if not loads and fixed_area is None and fixed_volume is None:
        return flow
    load = reduce(add, loads) if loads else None
    return Loaded(flow, load, fixed_area=fixed_area, fixed_volume=fixed_volume)


def _bending_flow(factor, term, consistency, weight) -> AbstractFlow:
    if isinstance(term, Willmore):
        return WillmoreFlow(0.5 * factor, 0.0, consistency, consistency_weight=weight)
    b_b, H0 = factor * term.bending_modulus, term.spontaneous_curvature
    b_k = factor * term.gaussian_modulus
    if b_b.ndim == H0.ndim == b_k.ndim == 0:
        return WillmoreFlow(b_b, H0, consistency, consistency_weight=weight)
    return HelfrichFlow(b_b, H0, b_k, consistency, consistency_weight=weight)

"""The parameters of Mem3DG in the convention of this package."""

from typing import Any

from ._base import AbstractEnergy
from ._canham_helfrich import CanhamHelfrich
from ._global import (
    AreaDifference,
    AreaPenalty,
    OsmoticPressure,
    Pressure,
    SurfaceTension,
    VolumePenalty,
)
from ._parameters import finite_field, positive, positive_field

# What `ambientSolutionOsmoticPressureModel` multiplies: Boltzmann's and Avogadro's constant in
# nN µm/K and 1/amol.
_MEM3DG_GAS_CONSTANT = 1.380649e-8 * 6.02214076e5


def from_mem3dg(
    Kb,
    *,
    H0: Any = 0.0,
    Kg: Any = 0.0,
    alpha=0.0,
    D=None,
    dA0=0.0,
    tension=None,
    modulus=None,
    preferred_area=None,
    pressure=None,
    strength=None,
    preferred_volume=None,
    enclosed_solute=None,
    ambient_concentration=None,
    temperature=293.0,
    half_bending=False,
) -> AbstractEnergy:
    r"""The energy of a Mem3DG model, as a sum of energies.

    Mem3DG writes $\bar H = (\kappa_1 + \kappa_2)/2$; here $H = \kappa_1 + \kappa_2$. Lengths in µm,
    forces in nN and amounts in amol pass through as they are.

    | Mem3DG | its energy | here |
    | --- | --- | --- |
    | `Kb`, `H0`, `Kg` | $2K_b(\bar H - \bar H_0)^2 + K_g K$ | `CanhamHelfrich(Kb/2, Kg, 2*H0)` |
    | `alpha`, `D`, `dA0` | $\alpha\pi K_b (2D\int\bar H-\Delta A_0)^2 / 4D^2A$ | `AreaDifference` |
    | `tension` | $\sigma A$ | `SurfaceTension` |
    | `modulus`, `preferred_area` | $\frac{K_A}{2}(A - \bar A)^2/\bar A$ | `AreaPenalty` |
    | `pressure` | $-P V$ | `Pressure` |
    | `strength`, `preferred_volume` | $\frac{K_V}{2}((V - \bar V)/\bar V)^2$ | `VolumePenalty` |
    | `enclosed_solute`, ... | $RTn(r - \ln r - 1)$, $r = \bar c V/n$ | `OsmoticPressure` |

    The modulus of `AreaDifference` is `alpha * Kb / 2`. The last five rows are its models
    `constantSurfaceTensionModel`, `preferredAreaSurfaceTensionModel`,
    `constantOsmoticPressureModel`, `preferredVolumeOsmoticPressureModel` and
    `ambientSolutionOsmoticPressureModel` with the names of their arguments.

    **Arguments:**

    - `Kb`, `H0`, `Kg`: numbers or nodal fields; with `Kbc`, `H0c`, `Kgc` give their value at the
      protein density of the node.
    - `alpha`: needs the thickness `D` and a `Kb` that is one number; 0 leaves the term out.
    - `half_bending`: Mem3DG up to March 2024 (before its pull request 65), and the article of 2022,
      have $K_b(\bar H - \bar H_0)^2$: half of the bending energy above.

    What is `None` is left out.

    **Raises:** `ValueError` for a half of a pair, for `alpha` with `half_bending` (its convention
    then is not known here), and for parameters out of range.

    *Limits:* no deviatoric modulus, protein, adsorption or self-avoidance; "line tension" there is
    $\int \tfrac\eta2|\nabla\phi|^2$, a `Density`.

    ```python
    energy = jw.energies.from_mem3dg(
        8.22e-5, modulus=0.1, preferred_area=12.4866, strength=0.02, preferred_volume=2.93
    )
    ```
    """
    Kb, H0 = positive_field("Kb", Kb), finite_field("H0", H0)
    energy = CanhamHelfrich(0.25 * Kb if half_bending else 0.5 * Kb, Kg, 2.0 * H0)
    terms: list[AbstractEnergy] = []
    if not _is_zero(alpha):
        if half_bending:
            raise ValueError("`alpha` cannot be translated together with `half_bending`.")
        if D is None:
            raise ValueError("`alpha` needs the thickness `D`.")
        terms.append(AreaDifference(0.5 * alpha * positive("Kb", Kb), dA0, D))
    if tension is not None:
        terms.append(SurfaceTension(tension))
    if pressure is not None:
        terms.append(Pressure(pressure))
    if _pair(modulus=modulus, preferred_area=preferred_area):
        terms.append(AreaPenalty(modulus, preferred_area))
    if _pair(strength=strength, preferred_volume=preferred_volume):
        terms.append(VolumePenalty(strength, preferred_volume))
    if _pair(enclosed_solute=enclosed_solute, ambient_concentration=ambient_concentration):
        terms.append(
            OsmoticPressure(
                enclosed_solute, ambient_concentration, temperature, _MEM3DG_GAS_CONSTANT
            )
        )
    return sum(terms, start=energy)


def _is_zero(alpha) -> bool:
    return isinstance(alpha, int | float) and alpha == 0


def _pair(**values) -> bool:
    """Whether both are given; one alone is an error."""
    missing = [name for name, value in values.items() if value is None]
    if len(missing) == 1:
        raise ValueError(f"`{missing[0]}` is missing: {' and '.join(values)} belong together.")
    return not missing

"""Energies of a surface, as functions of its nodes and of what lives on them."""

from ._base import (
    AbstractEnergy as AbstractEnergy,
    Combination as Combination,
    terms_of as terms_of,
)
from ._canham_helfrich import CanhamHelfrich as CanhamHelfrich
from ._density import (
    Density as Density,
    ExternalPotential as ExternalPotential,
    SurfacePoint as SurfacePoint,
)
from ._global import (
    AbstractGlobalEnergy as AbstractGlobalEnergy,
    AreaDifference as AreaDifference,
    AreaPenalty as AreaPenalty,
    OsmoticPressure as OsmoticPressure,
    Pressure as Pressure,
    SurfaceTension as SurfaceTension,
    VolumePenalty as VolumePenalty,
)
from ._mem3dg import from_mem3dg as from_mem3dg
from ._mixture import (
    AbstractModulus as AbstractModulus,
    Mixture as Mixture,
    modulus_at as modulus_at,
    modulus_jet as modulus_jet,
)
from ._parameters import (
    finite as finite,
    finite_field as finite_field,
    non_negative as non_negative,
    on_nodes as on_nodes,
    positive as positive,
    positive_field as positive_field,
)
from ._phase import FreeEnergy as FreeEnergy, GinzburgLandau as GinzburgLandau
from ._shape_derivative import shape_derivative as shape_derivative
from ._two_phase import TwoPhase as TwoPhase
from ._wells import (
    AbstractWell as AbstractWell,
    FloryHuggins as FloryHuggins,
    QuarticWell as QuarticWell,
)
from ._willmore import Willmore as Willmore, willmore_of_field as willmore_of_field
from ._words import energy_of as energy_of, words_of as words_of

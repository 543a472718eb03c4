"""Energies of a surface, as functions of its nodes."""

from ._base import AbstractEnergy as AbstractEnergy, terms_of as terms_of
from ._canham_helfrich import CanhamHelfrich as CanhamHelfrich
from ._global import (
    AbstractGlobalEnergy as AbstractGlobalEnergy,
    AreaDifference as AreaDifference,
    AreaPenalty as AreaPenalty,
    OsmoticPressure as OsmoticPressure,
    Pressure as Pressure,
    SurfaceTension as SurfaceTension,
    VolumePenalty as VolumePenalty,
)
from ._parameters import (
    finite as finite,
    non_negative as non_negative,
    positive as positive,
)
from ._shape_derivative import shape_derivative as shape_derivative
from ._willmore import Willmore as Willmore, willmore_of_field as willmore_of_field

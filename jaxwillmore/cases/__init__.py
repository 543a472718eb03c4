"""Cases: a TOML file, or the same in Python, that decides a whole run; `runs` performs it."""

from ._case import Case as Case
from ._energy_sections import (
    AreaDifferenceCase as AreaDifferenceCase,
    AreaPenaltyCase as AreaPenaltyCase,
    ConstraintsCase as ConstraintsCase,
    EnergyCase as EnergyCase,
    OsmoticCase as OsmoticCase,
    VolumePenaltyCase as VolumePenaltyCase,
    ball_volume as ball_volume,
    check_isoperimetric as check_isoperimetric,
)
from ._error import CaseError as CaseError
from ._examples import (
    example_names as example_names,
    example_path as example_path,
    fit_example_names as fit_example_names,
    is_example as is_example,
)
from ._fit_case import FitTask as FitTask, load_fit as load_fit
from ._fit_sections import (
    FLOW_PARAMETERS as FLOW_PARAMETERS,
    FitCase as FitCase,
    FlowModelCase as FlowModelCase,
    ModelCase as ModelCase,
    TargetCase as TargetCase,
)
from ._laws import LAWS as LAWS
from ._load import load_case as load_case
from ._mesh_section import MeshCase as MeshCase
from ._phase_section import PhaseCase as PhaseCase
from ._quantities import QUANTITIES as QUANTITIES, Quantity as Quantity
from ._sections import (
    FAIRING as FAIRING,
    HARMONICS as HARMONICS,
    OF_PHASES as OF_PHASES,
    BranchCase as BranchCase,
    EquilibriumCase as EquilibriumCase,
    FlowCase as FlowCase,
    OutputCase as OutputCase,
    SurfaceCase as SurfaceCase,
    TimeCase as TimeCase,
)

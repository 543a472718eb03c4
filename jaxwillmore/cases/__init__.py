"""Cases: a TOML file, or the same in Python, that decides a whole run."""

from ._branch import CaseBranch as CaseBranch, run_branch as run_branch
from ._case import Case as Case
from ._check import check_file as check_file
from ._doctor import diagnosis as diagnosis
from ._energy_sections import (
    AreaDifferenceCase as AreaDifferenceCase,
    AreaPenaltyCase as AreaPenaltyCase,
    ConstraintsCase as ConstraintsCase,
    EnergyCase as EnergyCase,
    OsmoticCase as OsmoticCase,
    VolumePenaltyCase as VolumePenaltyCase,
)
from ._equilibrium import (
    CaseEquilibrium as CaseEquilibrium,
    run_equilibrium as run_equilibrium,
)
from ._error import CaseError as CaseError
from ._examples import (
    example_names as example_names,
    example_path as example_path,
    fit_example_names as fit_example_names,
    is_example as is_example,
)
from ._fit import FitRun as FitRun, run_fit as run_fit
from ._fit_case import FitTask as FitTask, load_fit as load_fit
from ._fit_sections import (
    FitCase as FitCase,
    FlowModelCase as FlowModelCase,
    ModelCase as ModelCase,
    TargetCase as TargetCase,
)
from ._load import load_case as load_case
from ._phase_section import PhaseCase as PhaseCase
from ._resume import resume_case as resume_case
from ._run import CaseRun as CaseRun, run_case as run_case
from ._sections import (
    BranchCase as BranchCase,
    EquilibriumCase as EquilibriumCase,
    FlowCase as FlowCase,
    OutputCase as OutputCase,
    SurfaceCase as SurfaceCase,
    TimeCase as TimeCase,
)

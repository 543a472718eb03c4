"""Parameters from observed shapes, and what the data can say about them."""

from ._flow import fit_flow as fit_flow
from ._flow_fit import FlowFit as FlowFit, SeenShape as SeenShape
from ._force_balance import (
    FORCE_PARAMETERS as FORCE_PARAMETERS,
    ForceBalance as ForceBalance,
    force_balance as force_balance,
)
from ._identify import Identification as Identification, identify as identify
from ._likelihood import log_likelihood as log_likelihood
from ._match import match_shapes as match_shapes
from ._mesh_error import mesh_errors as mesh_errors
from ._parameters import (
    AbstractRange as AbstractRange,
    Between as Between,
    Positive as Positive,
    Unbounded as Unbounded,
)
from ._phase_fit import PhaseFit as PhaseFit, match_phases as match_phases
from ._pose import rotation as rotation
from ._profile import profile as profile
from ._results import RESULTS as RESULTS, message as message, name_of as name_of
from ._shape_fit import (
    MatchedShape as MatchedShape,
    MatchIterate as MatchIterate,
    ShapeFit as ShapeFit,
)
from ._targets import checked_surface as checked_surface
from ._unknowns import SHAPE_PARAMETERS as SHAPE_PARAMETERS
from ._verdict import VERDICTS as VERDICTS, Verdict as Verdict

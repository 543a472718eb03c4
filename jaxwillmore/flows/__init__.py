"""Flows: laws in weak form, one equation per function, and the system that composes them."""

from ._curvature_diffusion import CurvatureDiffusion as CurvatureDiffusion
from ._geometry import alignment as alignment
from ._gradient_flow import gradient_flow as gradient_flow
from ._helfrich import HelfrichFlow as HelfrichFlow
from ._law import (
    AbstractLaw as AbstractLaw,
    Field as Field,
    Globals as Globals,
    Local as Local,
    Statement as Statement,
    Units as Units,
    Whole as Whole,
)
from ._loads import Loads as Loads
from ._mean_curvature import MeanCurvatureFlow as MeanCurvatureFlow
from ._motion import Forcing as Forcing, GivenMotion as GivenMotion, NoDrift as NoDrift
from ._phase import AllenCahn as AllenCahn, CahnHilliard as CahnHilliard, Mixing as Mixing
from ._surface_diffusion import SurfaceDiffusion as SurfaceDiffusion
from ._system import SLIP as SLIP, System as System, as_system as as_system
from ._tangential import MinimalDeformation as MinimalDeformation
from ._willmore import WillmoreFlow as WillmoreFlow

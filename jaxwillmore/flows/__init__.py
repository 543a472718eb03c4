"""Geometric flows in weak form, one equation per function."""

from ._base import AbstractFlow as AbstractFlow
from ._gradient_flow import gradient_flow as gradient_flow
from ._helfrich import HelfrichFlow as HelfrichFlow
from ._loaded import Loaded as Loaded
from ._mean_curvature import MeanCurvatureFlow as MeanCurvatureFlow
from ._surface_diffusion import SurfaceDiffusion as SurfaceDiffusion
from ._tangential import MinimalDeformation as MinimalDeformation
from ._willmore import WillmoreFlow as WillmoreFlow

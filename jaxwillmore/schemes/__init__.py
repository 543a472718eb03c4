"""Linearly implicit schemes of fixed step from the literature: what the flows are compared with."""

from ._base import AbstractScheme as AbstractScheme
from ._bgn_mean_curvature import BGNMeanCurvature as BGNMeanCurvature
from ._bgn_willmore import BGNWillmore as BGNWillmore
from ._dziuk_mean_curvature import DziukMeanCurvature as DziukMeanCurvature
from ._dziuk_willmore import DziukWillmore as DziukWillmore
from ._march import Grid as Grid, March as March, grid as grid, march as march, step as step

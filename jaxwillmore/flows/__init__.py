"""Geometric flows in weak form, one equation per function."""

from ._base import AbstractFlow as AbstractFlow
from ._loaded import Loaded as Loaded
from ._tangential import MinimalDeformation as MinimalDeformation
from ._willmore import WillmoreFlow as WillmoreFlow

"""Geometric flows in weak form, one equation per function."""

from ._base import AbstractFlow as AbstractFlow
from ._willmore import WillmoreFlow as WillmoreFlow

"""Sparse linear and nonlinear systems; knows nothing about surfaces."""

from ._newton import EXACT as EXACT, SparseNewton as SparseNewton
from ._operator import Border as Border, SparseOperator as SparseOperator
from ._pattern import (
    BlockPattern as BlockPattern,
    block_pattern as block_pattern,
    scatter_blocks as scatter_blocks,
)
from ._solver import PreparedMatrix as PreparedMatrix, SparseSolver as SparseSolver
from ._system import AbstractSparseSystem as AbstractSparseSystem

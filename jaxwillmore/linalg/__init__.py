"""Sparse linear and nonlinear systems; knows nothing about surfaces."""

from ._groups import TangentGroup as TangentGroup
from ._host import clear as clear
from ._host_matrix import HostMatrix as HostMatrix
from ._host_newton import HostNewton as HostNewton
from ._host_solve import solve_on_host as solve_on_host
from ._host_system import HostSolution as HostSolution, HostSystem as HostSystem
from ._memory import system_bytes as system_bytes
from ._methods import checked_method as checked_method
from ._newton import EXACT as EXACT, SparseNewton as SparseNewton
from ._operator import Border as Border, SparseOperator as SparseOperator
from ._pattern import (
    BlockPattern as BlockPattern,
    block_pattern as block_pattern,
    scatter_blocks as scatter_blocks,
)
from ._solver import PreparedMatrix as PreparedMatrix, SparseSolver as SparseSolver
from ._system import AbstractSparseSystem as AbstractSparseSystem
from ._threads import one_blas_thread as one_blas_thread

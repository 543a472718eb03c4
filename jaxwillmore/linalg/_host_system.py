"""What the host's Newton iteration asks of a system, and what it returns."""

import dataclasses
from typing import Protocol, runtime_checkable

import numpy as np
import optimistix as optx

from ._host_matrix import HostMatrix
from ._pattern import BlockPattern


@runtime_checkable
class HostSystem(Protocol):
    """Equations F(y) = 0 in NumPy: `AbstractSparseSystem` outside any traced function.

    The vector holds the nodal unknowns, node by node, then `n_globals` global ones, all divided by
    their typical size. Methods may call jitted functions.

    **Attributes:**

    - `pattern`: sparsity of the Jacobian.
    - `n_fields`, `n_globals`: columns per node, and global unknowns.
    - `spans`: the columns of every field, for its own measure of convergence.
    - `groups`: for the preconditioner, as of `SparseSolver`.
    """

    @property
    def pattern(self) -> BlockPattern: ...

    @property
    def n_fields(self) -> int: ...

    @property
    def n_globals(self) -> int: ...

    @property
    def spans(self) -> tuple[slice, ...]: ...

    @property
    def groups(self) -> tuple: ...

    def residual(self, y: np.ndarray) -> np.ndarray:
        """F(y), rows scaled to comparable size."""
        ...

    def jacobian(self, y: np.ndarray) -> tuple:
        """The blocks of the derivative, and its border (columns, rows, corner) or None.

        The arrays are kept without a copy: give new ones in every call.
        """
        ...


@dataclasses.dataclass(frozen=True)
class HostSolution:
    """The end of a host solve.

    **Attributes:**

    - `y`, `f`: the last vector and its residual.
    - `result`: `optx.RESULTS.successful`, or why it failed.
    - `iterations`: Newton corrections; `jacobians`, `residuals`: evaluations.
    - `krylov_iterations`: of GMRES, all solves together.
    - `global_corrections`: of the global unknowns alone, after the fields had converged.
    - `kept`: the last Jacobian with its factors, for the next solve; nothing after a failure.
    """

    y: np.ndarray
    f: np.ndarray
    result: optx.RESULTS
    iterations: int
    jacobians: int
    krylov_iterations: int
    residuals: int
    global_corrections: int
    kept: HostMatrix | None

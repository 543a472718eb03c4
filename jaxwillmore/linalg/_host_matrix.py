"""HostMatrix: a sparse matrix that host code solves with, outside any traced function."""

import weakref

import lineax as lx
import numpy as np

from ._factorised import NON_FINITE, NOT_CONVERGED, SINGULAR, Factorised, backend
from ._host import HOST
from ._krylov import Elimination
from ._methods import checked_method
from ._pattern import BlockPattern

FAILURES = {
    NOT_CONVERGED: lx.RESULTS.breakdown,
    SINGULAR: lx.RESULTS.singular,
    NON_FINITE: lx.RESULTS.nonfinite_input,
}


def pattern_arrays(pattern: BlockPattern):
    """What the host needs of a pattern."""
    return pattern.indptr, pattern.cols, pattern.rows, pattern.order, pattern.key


class HostMatrix:
    """A bordered block matrix with its factors, outside any traced function.

    It solves with `SparseSolver`'s algorithms and methods. The factors live until `release`, or
    until nothing refers to the matrix, or until `linalg.clear()`.

    **Arguments:**

    - `pattern`, `data`: as of `SparseOperator`. The array is kept without a copy: do not write
      into it afterwards.
    - `border`: columns, rows and corner of the global unknowns, if there are any.
    - `groups`, `method`: as of `SparseSolver`.

    **Raises:** `ValueError` for a method that cannot be used, or not for so many unknowns.
    """

    def __init__(
        self,
        pattern: BlockPattern,
        data,
        border: tuple | None = None,
        groups: tuple = (),
        method: str = "krylov",
    ):
        data = np.asarray(data)
        if border is None:
            empty = np.zeros((0, pattern.n_nodes, data.shape[1]))
            border = empty, empty, np.zeros((0, 0))
        self.n_globals = len(border[2])
        self.n_unknowns = pattern.n_nodes * data.shape[1] + self.n_globals
        chosen = backend(groups, checked_method(method, self.n_unknowns))
        self._handle = HOST.hold(chosen, data, border, pattern_arrays(pattern))
        self._released = weakref.finalize(self, HOST.release, self._handle)
        self._released.atexit = False

    @property
    def alive(self) -> bool:
        """Whether its factors have not been freed."""
        return self._released.alive and HOST.held(self._handle) is not None

    def _held(self) -> Factorised:
        matrix = HOST.held(self._handle)
        if matrix is None or not self.alive:
            raise ValueError("This matrix has been released; assemble it again.")
        return matrix

    @property
    def nbytes(self) -> int:
        """Memory of matrix and factors."""
        return self._held().nbytes

    def solve(self, rhs, rtol: float, transpose: bool = False) -> tuple[np.ndarray, int, int]:
        """Solution, GMRES iterations, and 0 or a key of `FAILURES`.

        **Raises:** `ValueError` if the matrix has been released.
        """
        return HOST.run(self._held().solve, np.asarray(rhs), transpose, rtol)

    @property
    def is_whole(self) -> bool:
        """Whether the whole matrix has been factorised, as it is for good where GMRES stalls."""
        return self._held().is_whole

    def factorise_whole(self):
        """Factorise the whole matrix now; `RuntimeError` where it is exactly singular."""
        HOST.run(self._held().inverse, False, True)

    def elimination(self) -> Elimination:
        """The preconditioner with its `W` and `schur`; the matrix must have solved before."""
        return HOST.run(self._held().inverse)

    def release(self):
        """Free matrix and factors, at once."""
        self._released()
        HOST.free()

"""MKL Pardiso behind the interface of `SuperLU`; needs the extra `fast`."""

import numpy as np

from ._direct import ColumnStructure


class Pardiso:
    """LU factors of one block matrix by MKL Pardiso, in Pardiso's own ordering."""

    def __init__(self, structure: ColumnStructure, data: np.ndarray):
        from pypardiso import PyPardisoSolver

        self._structure = structure
        self._matrix = structure.matrix(data).tocsr()
        # A fresh solver for each matrix: one instance keeps a single factorisation.
        self._solver = PyPardisoSolver()
        self._solver.factorize(self._matrix)

    @property
    def nbytes(self) -> int:
        """Memory of the matrix and of its factors; iparm(17) counts the latter in kilobytes."""
        return 1024 * int(self._solver.get_iparm(17)) + 12 * self._matrix.nnz

    def solve(self, rhs: np.ndarray, transpose: bool) -> np.ndarray:
        """Solve for nodal arrays of shape `nodes fields` or `nodes fields columns`."""
        s = self._structure
        flat = np.asfortranarray(s.permute(rhs).reshape(rhs.shape[0] * s.n_fields, -1))
        # iparm(12) = 2 solves with the transpose of the factorised matrix.
        self._solver.set_iparm(12, 2 if transpose else 0)
        self._solver.set_phase(33)
        out = self._solver._call_pardiso(self._matrix, flat)
        return s.restore(np.asarray(out).reshape(rhs.shape))

    def __del__(self):
        self._solver.free_memory(everything=True)

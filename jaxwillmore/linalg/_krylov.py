"""Block Gauss–Seidel preconditioner from small factorisations. NumPy and SciPy only."""

import numpy as np
import scipy.sparse as sp

from ._direct import ColumnStructure, Pattern


def block_matrix(pattern: Pattern, data: np.ndarray) -> sp.bsr_matrix:
    """The assembled matrix in block compressed rows."""
    n = pattern.n_nodes
    shape = (n * data.shape[1], n * data.shape[2])
    return sp.bsr_matrix((np.ascontiguousarray(data), pattern.cols, pattern.indptr), shape=shape)


class GaussSeidel:
    """One sweep of block Gauss–Seidel over groups of fields.

    A group is a tuple of column tuples, its *copies*: the copies share one factorisation, that of
    the mean of their diagonal blocks (the components of ν with those of z, say). Groups are solved
    in order; the transpose sweeps backwards, so that it is the transpose of the preconditioner.
    """

    def __init__(self, pattern: Pattern, data: np.ndarray, groups, structures, factorise):
        self._groups = groups
        self._n = pattern.n_nodes
        self._lus = []
        for group in groups:
            mean = sum(data[np.ix_(range(len(data)), copy, copy)] for copy in group) / len(group)
            structure: ColumnStructure = structures(len(group[0]))
            self._lus.append(factorise(structure, mean))
        # Coupling of a group to the ones solved before it.
        columns = [[c for copy in group for c in copy] for group in groups]
        self._columns = columns
        self._lower = {}
        for i in range(len(groups)):
            for j in range(i):
                block = data[np.ix_(range(len(data)), columns[i], columns[j])]
                if np.any(block):
                    self._lower[i, j] = block_matrix(pattern, block)

    def _solve_group(self, i, rhs, transpose):
        copies = len(self._groups[i])
        width = len(self._groups[i][0])
        stacked = rhs.reshape(self._n, copies, width).transpose(0, 2, 1)
        out = self._lus[i].solve(np.ascontiguousarray(stacked), transpose)
        return out.transpose(0, 2, 1).reshape(self._n, copies * width)

    def apply(self, vector: np.ndarray, transpose: bool) -> np.ndarray:
        """Approximate solution of the (transposed) system for a flat vector."""
        r = vector.reshape(self._n, -1)
        parts = [np.ascontiguousarray(r[:, c]) for c in self._columns]
        x = [None] * len(parts)
        order = range(len(parts))
        for i in reversed(order) if transpose else order:
            rhs = parts[i]
            for (a, b), block in self._lower.items():
                if not transpose and a == i and x[b] is not None:
                    rhs = rhs - (block @ x[b].reshape(-1)).reshape(rhs.shape)
                if transpose and b == i and x[a] is not None:
                    rhs = rhs - (block.T @ x[a].reshape(-1)).reshape(rhs.shape)
            x[i] = self._solve_group(i, rhs, transpose)
        out = np.empty_like(r)
        for c, part in zip(self._columns, x, strict=True):
            out[:, c] = part
        return out.reshape(-1)

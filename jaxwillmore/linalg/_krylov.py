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
        # Coupling of a group to the ones solved before it; the transpose where one is asked for.
        columns = [[c for copy in group for c in copy] for group in groups]
        self._columns = columns
        self._lower = {}
        for i in range(len(groups)):
            for j in range(i):
                block = data[np.ix_(range(len(data)), columns[i], columns[j])]
                if np.any(block):
                    self._lower[i, j] = block_matrix(pattern, block)
        self._upper: dict | None = None

    def _coupling(self, transpose: bool) -> dict:
        """Blocks by (group that is solved, group solved before it)."""
        if not transpose:
            return self._lower
        if self._upper is None:
            self._upper = {(j, i): block.T for (i, j), block in self._lower.items()}
        return self._upper

    def _solve_group(self, i, rhs, transpose):
        copies = len(self._groups[i])
        width = len(self._groups[i][0])
        stacked = rhs.reshape(self._n, copies, width).transpose(0, 2, 1)
        out = self._lus[i].solve(np.ascontiguousarray(stacked), transpose)
        return out.transpose(0, 2, 1).reshape(self._n, copies * width)

    def apply(self, vector: np.ndarray, transpose: bool) -> np.ndarray:
        """Approximate solution of the (transposed) system for a flat nodal vector."""
        r = vector.reshape(self._n, -1)
        parts = [np.ascontiguousarray(r[:, c]) for c in self._columns]
        x = list(parts)
        order = range(len(parts))
        coupling = self._coupling(transpose)
        for i in reversed(order) if transpose else order:
            rhs = parts[i]
            for (a, b), block in coupling.items():
                if a == i:
                    rhs = rhs - (block @ x[b].reshape(-1)).reshape(rhs.shape)
            x[i] = self._solve_group(i, rhs, transpose)
        out = np.empty_like(r)
        for c, part in zip(self._columns, x, strict=True):
            out[:, c] = part
        return out.reshape(-1)


class Bordered:
    """A matrix with a border, and a preconditioner for it from one for its nodal part.

    Block elimination: with an approximate inverse P of the nodal part, W = P B is computed once per
    matrix, and the Schur complement D - C W is exact for that P.
    """

    def __init__(self, matrix, columns: np.ndarray, rows: np.ndarray, corner: np.ndarray):
        self._n_globals = len(corner)
        self._matrix, self._transposed = matrix, None
        size = matrix.shape[0]
        self._B = columns.reshape(self._n_globals, size).T
        self._C = rows.reshape(self._n_globals, size)
        self._D = corner

    def times(self, vector: np.ndarray, transpose: bool) -> np.ndarray:
        """The product with the bordered matrix or its transpose."""
        A = self._matrix
        if transpose:
            # A transposed block matrix is a copy, which costs as much as several products.
            if self._transposed is None:
                self._transposed = A.T
            A = self._transposed
        if self._n_globals == 0:
            return A @ vector
        B, C, D = (self._C.T, self._B.T, self._D.T) if transpose else (self._B, self._C, self._D)
        nodal, tail = vector[: -self._n_globals], vector[-self._n_globals :]
        return np.concatenate([A @ nodal + B @ tail, C @ nodal + D @ tail])

    def preconditioner(self, apply, transpose: bool):
        """Extend `apply`, which maps nodal vectors, to the bordered vector."""
        m = self._n_globals
        if m == 0:
            return apply
        B, C, D = (self._C.T, self._B.T, self._D.T) if transpose else (self._B, self._C, self._D)
        W = np.stack([apply(np.ascontiguousarray(column)) for column in B.T], axis=1)
        schur = D - C @ W

        def extended(vector):
            first = apply(vector[:-m])
            tail = np.linalg.lstsq(schur, vector[-m:] - C @ first, rcond=None)[0]
            return np.concatenate([first - W @ tail, tail])

        return extended

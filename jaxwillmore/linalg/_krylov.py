"""Block Gauss–Seidel preconditioner from small factorisations. NumPy and SciPy only."""

from collections.abc import Callable

import numpy as np

from ._direct import Pattern
from ._groups import Transposable, block_matrix, group_solver, submatrix


class GaussSeidel:
    """One sweep of block Gauss–Seidel over groups of fields.

    A group is a tuple of column tuples, its *copies*: the copies share one factorisation, that of
    the mean of their diagonal blocks (the components of ν with those of z, say); or it is a
    `TangentGroup`. Groups are solved in order; the transpose sweeps backwards, so that it is the
    transpose of the preconditioner.
    """

    def __init__(self, pattern: Pattern, data: np.ndarray, groups, structures, factorise):
        self._n = pattern.n_nodes
        self._groups = [group_solver(g, pattern, data, structures, factorise) for g in groups]
        # Coupling of a group to the ones solved before it.
        self._lower: dict[tuple[int, int], Transposable] = {}
        for i, group in enumerate(self._groups):
            for j in range(i):
                block = submatrix(data, group.columns, self._groups[j].columns)
                if np.any(block):
                    self._lower[i, j] = Transposable(block_matrix(pattern, block))

    @property
    def nbytes(self) -> int:
        """Memory of factors and couplings."""
        return sum(part.nbytes for part in (*self._groups, *self._lower.values()))

    def apply(self, vector: np.ndarray, transpose: bool) -> np.ndarray:
        """Approximate solution of the (transposed) system for a flat nodal vector."""
        r = vector.reshape(self._n, -1)
        out = np.empty_like(r)
        x: dict[int, np.ndarray] = {}
        order = range(len(self._groups))
        for i in reversed(order) if transpose else order:
            columns = self._groups[i].columns
            rhs = np.ascontiguousarray(r[:, columns])
            for pair, block in self._lower.items():
                target, source = reversed(pair) if transpose else pair
                if target == i:
                    rhs = rhs - block.times(x[source], transpose)
            out[:, columns] = x[i] = self._groups[i].solve(rhs, transpose)
        return out.reshape(-1)


class Bordered:
    """A matrix with a border, and a preconditioner for it from one for its nodal part."""

    def __init__(self, matrix, columns: np.ndarray, rows: np.ndarray, corner: np.ndarray):
        self._n_globals = len(corner)
        self._matrix = Transposable(matrix)
        size = matrix.shape[0]
        self._B = columns.reshape(self._n_globals, size).T
        self._C = rows.reshape(self._n_globals, size)
        self._D = corner

    @property
    def nbytes(self) -> int:
        """Memory of the entries."""
        return self._matrix.nbytes + self._B.nbytes + self._C.nbytes

    def _border(self, transpose: bool):
        return (self._C.T, self._B.T, self._D.T) if transpose else (self._B, self._C, self._D)

    def times(self, vector: np.ndarray, transpose: bool) -> np.ndarray:
        """The product with the bordered matrix or its transpose."""
        if self._n_globals == 0:
            return self._matrix.times(vector, transpose)
        B, C, D = self._border(transpose)
        nodal, tail = vector[: -self._n_globals], vector[-self._n_globals :]
        first = self._matrix.times(nodal, transpose) + B @ tail
        return np.concatenate([first, C @ nodal + D @ tail])

    def sizes(self, vector: np.ndarray, transpose: bool) -> np.ndarray:
        """|A| |x|, the sums of the sizes of what a product adds up."""
        parts = abs(self._matrix.matrix), abs(self._B.T), abs(self._C), abs(self._D)
        return Bordered(*parts).times(abs(vector), transpose)

    def preconditioner(self, apply: Callable, transpose: bool) -> "Elimination":
        """Extend `apply`, which maps nodal vectors, to the bordered vector."""
        return Elimination(apply, *self._border(transpose))


class Elimination:
    r"""Block elimination of the border with an approximate inverse $P$ of the nodal part.

    $W = PB$ is computed once per matrix, and the Schur complement $S = D - CW$ is exact for that
    $P$.

    **Attributes:**

    - `W`: what the nodal unknowns do, up to the sign, when a global one changes by one.
    - `schur`: what the global equations then do.
    """

    def __init__(self, apply: Callable, B: np.ndarray, C: np.ndarray, D: np.ndarray):
        self._apply, self._C = apply, C
        self.W = np.empty(B.shape)
        for k, column in enumerate(B.T):
            self.W[:, k] = apply(np.ascontiguousarray(column))
        self.schur = D - C @ self.W

    @property
    def nbytes(self) -> int:
        """Memory of W."""
        return self.W.nbytes

    def __call__(self, vector: np.ndarray) -> np.ndarray:
        m = len(self.schur)
        if m == 0:
            return self._apply(vector)
        first = self._apply(vector[:-m])
        tail = np.linalg.lstsq(self.schur, vector[-m:] - self._C @ first, rcond=None)[0]
        return np.concatenate([first - self.W @ tail, tail])

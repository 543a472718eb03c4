"""LU on the host, sparse in nested-dissection order or dense.

NumPy and SciPy only: it runs in callbacks.
"""

import dataclasses

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.linalg import splu


@dataclasses.dataclass(frozen=True)
class Pattern:
    """The arrays of a `BlockPattern` as NumPy sees them."""

    indptr: np.ndarray
    cols: np.ndarray
    rows: np.ndarray
    order: np.ndarray

    @property
    def n_nodes(self) -> int:
        return len(self.order)


class ColumnStructure:
    """Compressed columns of a block matrix with its nodes in elimination order.

    Built once for a pattern and a block size; a new matrix costs one pass over its entries.
    """

    def __init__(self, pattern: Pattern, n_fields: int):
        n, f = pattern.n_nodes, n_fields
        place = np.empty(n, np.int64)
        place[pattern.order] = np.arange(n)
        row, col = place[pattern.rows], place[pattern.cols]
        self._sorted = np.lexsort((row, col))
        row, col = row[self._sorted], col[self._sorted]
        count = np.bincount(col, minlength=n)
        start = np.concatenate([[0], np.cumsum(count)])
        within = np.arange(len(col)) - start[col]
        field = np.arange(f)
        # Entry (f, g) of block b: column g of the block column, after the blocks above it.
        self._entry = (
            start[col][:, None, None] * f * f
            + field[None, None, :] * (count[col] * f)[:, None, None]
            + within[:, None, None] * f
            + field[None, :, None]
        ).reshape(-1)
        self._indices = np.empty(len(col) * f * f, np.int32)
        self._indices[self._entry] = np.broadcast_to(
            (row[:, None] * f + field)[:, :, None], (len(col), f, f)
        ).reshape(-1)
        widths = np.repeat(count * f, f)
        self._indptr = np.concatenate([[0], np.cumsum(widths)]).astype(np.int32)
        self._nodes = pattern.order
        self.n_fields = f

    @property
    def nbytes(self) -> int:
        """Memory of the index arrays."""
        return self._entry.nbytes + self._indices.nbytes + self._sorted.nbytes

    def matrix(self, data: np.ndarray) -> sp.csc_matrix:
        """The scalar matrix of the blocks `data`."""
        values = np.empty(len(self._entry))
        values[self._entry] = data[self._sorted].reshape(-1)
        n = len(self._indptr) - 1
        return sp.csc_matrix((values, self._indices, self._indptr), shape=(n, n))

    def permute(self, vector: np.ndarray) -> np.ndarray:
        """Nodal array to elimination order."""
        return vector[self._nodes]

    def restore(self, vector: np.ndarray) -> np.ndarray:
        """Elimination order to nodal array."""
        out = np.empty_like(vector)
        out[self._nodes] = vector
        return out


class SuperLU:
    """LU factors of one block matrix by SuperLU.

    The pivot threshold is low on purpose: the stiffness entries outgrow the mass diagonal on fine
    meshes, and wherever that makes SuperLU leave the elimination order it fills in 2 to 5 times as
    much. With 1e-8 it stays; residuals are 1e-10 or better before refinement.
    """

    def __init__(self, structure: ColumnStructure, data: np.ndarray):
        self._structure = structure
        self._lu = splu(
            structure.matrix(data),
            permc_spec="NATURAL",
            diag_pivot_thresh=1e-8,
            options={"SymmetricMode": True},
        )

    @property
    def nbytes(self) -> int:
        """Memory of the factors: a value of 8 bytes and an index of 4 per entry, at most."""
        return 12 * self._lu.nnz

    def solve(self, rhs: np.ndarray, transpose: bool) -> np.ndarray:
        """Solve for nodal arrays of shape `nodes fields` or `nodes fields columns`."""
        s = self._structure
        flat = s.permute(rhs).reshape(rhs.shape[0] * s.n_fields, -1)
        out = self._lu.solve(flat, "T" if transpose else "N")
        return s.restore(out.reshape(rhs.shape))


class Lapack:
    """Dense LU factors of one small block matrix."""

    def __init__(self, structure: ColumnStructure, data: np.ndarray):
        self._structure = structure
        self._lu = scipy.linalg.lu_factor(structure.matrix(data).toarray(), check_finite=False)

    @property
    def nbytes(self) -> int:
        """Memory of the factors."""
        return self._lu[0].nbytes

    def solve(self, rhs: np.ndarray, transpose: bool) -> np.ndarray:
        """Solve for nodal arrays of shape `nodes fields` or `nodes fields columns`."""
        s = self._structure
        flat = s.permute(rhs).reshape(rhs.shape[0] * s.n_fields, -1)
        out = scipy.linalg.lu_solve(self._lu, flat, int(transpose), check_finite=False)
        return s.restore(out.reshape(rhs.shape))

"""Groups of fields that the preconditioner solves exactly, or nearly. NumPy and SciPy only."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse as sp

from ._direct import Pattern


def block_matrix(pattern: Pattern, data: np.ndarray) -> sp.bsr_matrix:
    """The assembled matrix in block compressed rows; it keeps `data` without a copy."""
    n = pattern.n_nodes
    shape = (n * data.shape[1], n * data.shape[2])
    return sp.bsr_matrix((np.ascontiguousarray(data), pattern.cols, pattern.indptr), shape=shape)


def submatrix(data: np.ndarray, rows: Sequence[int], columns: Sequence[int]) -> np.ndarray:
    """The blocks of some equations by some unknowns."""
    return data[:, np.asarray(rows)[:, None], np.asarray(columns)]


class Transposable:
    """A block matrix that also multiplies transposed.

    The transpose of a matrix in block rows is a copy, which costs as much as several products: it
    is made once, where it is asked for.
    """

    def __init__(self, matrix: sp.bsr_matrix):
        self.matrix = matrix
        self._transposed: sp.bsr_matrix | None = None

    @property
    def nbytes(self) -> int:
        """Memory of the entries; the pattern is shared."""
        return self.matrix.data.nbytes * (1 if self._transposed is None else 2)

    def times(self, array: np.ndarray, transpose: bool) -> np.ndarray:
        """The product with a flat vector, or with `nodes fields`, in the shape it came in."""
        matrix = self.matrix
        if transpose:
            if self._transposed is None:
                self._transposed = matrix.T
            matrix = self._transposed
        return (matrix @ array.reshape(-1)).reshape(*array.shape[:-1], -1)


@dataclasses.dataclass(frozen=True)
class TangentGroup:
    r"""A vector field that a scalar multiplier keeps tangential, as a group of `SparseSolver`.

    Its equations are $(\nabla w, \nabla\eta) + (\kappa\nu, \eta) = \dots$ and
    $(w\cdot\nu, \xi) = \dots$: a saddle point, as of a velocity of minimal deformation rate.

    ??? cite "Reference"
        Hu, Li (2022), *Numer. Math.* 152, 127–181.

    **Arguments:**

    - `w`: the three columns of the field.
    - `kappa`: the column of the multiplier.
    - `steps`: of refinement in the solve of the group. Two need as many iterations of GMRES as an
      exact solve; one is cheaper and needs a few more on coarse meshes.

    **Raises:** `ValueError` for other than three columns, or no step.
    """

    w: tuple[int, ...]
    kappa: int
    steps: int = 2

    def __post_init__(self):
        if len(self.w) != 3:
            raise ValueError(f"`w` needs three columns; got {self.w}.")
        if self.steps < 1:
            raise ValueError(f"`steps` must be 1 or more; got {self.steps}.")


class Copies:
    """Copies of a few fields that share one factorisation, that of their mean diagonal block."""

    def __init__(self, group: tuple, data: np.ndarray, structures: Callable, factorise: Callable):
        self.columns = [column for copy in group for column in copy]
        self._shape = len(group), len(group[0])
        mean = sum(submatrix(data, copy, copy) for copy in group) / len(group)
        self._lu = factorise(structures(len(group[0])), mean)

    @property
    def nbytes(self) -> int:
        """Memory of the factors."""
        return self._lu.nbytes

    def solve(self, rhs: np.ndarray, transpose: bool) -> np.ndarray:
        """Solve for `nodes columns`."""
        stacked = rhs.reshape(len(rhs), *self._shape).transpose(0, 2, 1)
        out = self._lu.solve(np.ascontiguousarray(stacked), transpose)
        return out.transpose(0, 2, 1).reshape(rhs.shape)


class TangentFrames:
    r"""A `TangentGroup`, solved in nodal frames: normal part, tangential part, multiplier in turn.

    With the nodal normals $N$ and tangents $E$, and $w = Na + E^Tt$, the tangency alone gives $a$,
    the tangential equations then $t$, and the normal ones $\kappa$. What is left out are the
    tangential part in the tangency and the multiplier in the tangential equations, both of the
    size of the angle between the normals of neighbours; a second step makes up for it. A matrix of
    two fields and two scalar ones are factorised instead of one of four fields.

    The normals are those of the matrix: the diagonal block of $(w\cdot\nu, \xi)$ at a node is a
    mean of $\nu$ around it.
    """

    def __init__(self, group: TangentGroup, pattern: Pattern, data, structures, factorise):
        self.columns, self._steps = [*group.w, group.kappa], group.steps
        row, col = pattern.rows, pattern.cols
        block = submatrix(data, self.columns, self.columns)
        by_w, by_kappa = block[:, 3, :3], block[:, :3, 3]
        nu = by_w[row == col]
        length = np.linalg.norm(nu, axis=1, keepdims=True)
        if not np.all(length > 0):
            raise RuntimeError("A node has no normal: the tangential block is singular.")
        self._nu = nu = nu / length
        self._E = E = _tangents(nu)
        self._whole = Transposable(block_matrix(pattern, block))
        self._field = Transposable(block_matrix(pattern, block[:, :3, :3]))
        both = np.einsum("bij,bjk,blk->bil", E[row], block[:, :3, :3], E[col], optimize=True)
        tangency = np.einsum("bk,bk->b", by_w, nu[col])
        multiplier = np.einsum("bk,bk->b", by_kappa, nu[row])
        self._tangential = factorise(structures(2), both)
        self._tangency = factorise(structures(1), tangency[:, None, None])
        self._multiplier = factorise(structures(1), multiplier[:, None, None])

    @property
    def nbytes(self) -> int:
        """Memory of the factors and of the blocks of the group."""
        factors = (self._tangential, self._tangency, self._multiplier)
        return sum(part.nbytes for part in (*factors, self._whole, self._field))

    def solve(self, rhs: np.ndarray, transpose: bool) -> np.ndarray:
        """Solve for `nodes columns`; the transpose is that of the same approximate inverse."""
        step = self._backward if transpose else self._forward
        x = step(rhs)
        for _ in range(self._steps - 1):
            x = x + step(rhs - self._whole.times(x, transpose))
        return x

    def _forward(self, rhs):
        r, r_kappa = rhs[:, :3], rhs[:, 3:]
        w = self._tangency.solve(r_kappa, False) * self._nu
        left = self._across(r - self._field.times(w, False))
        w = w + self._along(self._tangential.solve(left, False))
        left = self._normal(r - self._field.times(w, False))
        return np.concatenate([w, self._multiplier.solve(left, False)], axis=1)

    def _backward(self, rhs):
        # The steps of `_forward`, transposed, in reverse order.
        r, r_kappa = rhs[:, :3], rhs[:, 3:]
        w = self._multiplier.solve(r_kappa, True) * self._nu
        r = r - self._field.times(w, True)
        t = self._along(self._tangential.solve(self._across(r), True))
        left = self._normal(r - self._field.times(t, True))
        return np.concatenate([w + t, self._tangency.solve(left, True)], axis=1)

    def _normal(self, w):
        return np.einsum("nk,nk->n", self._nu, w)[:, None]

    def _across(self, w):
        return np.einsum("nik,nk->ni", self._E, w)

    def _along(self, t):
        return np.einsum("nik,ni->nk", self._E, t)


def _tangents(nu: np.ndarray) -> np.ndarray:
    """Two unit vectors at every node, orthogonal to `nu` and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(nu), axis=1)]
    first = np.cross(nu, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(nu, first)], axis=1)


def group_solver(group, pattern: Pattern, data, structures, factorise) -> Copies | TangentFrames:
    """The solver of a group: a tuple of copies, each a tuple of columns, or a `TangentGroup`."""
    if isinstance(group, TangentGroup):
        return TangentFrames(group, pattern, data, structures, factorise)
    return Copies(group, data, structures, factorise)

"""A matrix on the host with whatever has been factorised of it. NumPy and SciPy only."""

import functools as ft
from collections.abc import Callable

import numpy as np

from ._direct import ColumnStructure, Lapack, Pattern, SuperLU
from ._flexible import flexible_gmres
from ._groups import block_matrix
from ._krylov import Bordered, Elimination, GaussSeidel

SUCCESS, NOT_CONVERGED, SINGULAR, NON_FINITE = range(4)
# Adding up a row of k entries errs by up to k units of rounding of |A||x| + |b|, and typically by
# the root of k, which is 9 to 15 here (7 to 19 blocks of 12 fields). What GMRES and the triangular
# solves add is a few times that.
ROUNDING = 64 * np.finfo(float).eps
# A vector that misses the right-hand side by more solves nothing, however badly A is conditioned.
LARGEST_RESIDUAL = 1e-6


class Backend:
    """How matrices are factorised: block groups for the preconditioner, and a direct solver."""

    def __init__(self, groups: tuple, direct: bool, factorise: Callable = SuperLU):
        self.groups = groups
        self.direct = direct
        self.factorise = factorise


@ft.cache
def backend(groups: tuple, method: str) -> Backend:
    """The backend of a method of `SparseSolver`."""
    if method == "pardiso":
        from ._pardiso import Pardiso

        return Backend(groups, True, Pardiso)
    if method == "dense":
        return Backend(groups, True, Lapack)
    return Backend(groups, method == "direct" or not groups)


class Factorised:
    """A bordered block matrix; it is factorised as far as solves ask for it.

    It keeps `data` and `border` without a copy.

    **Arguments:**

    - `structures`: symbolic data of the pattern by the number of fields.
    """

    def __init__(
        self,
        backend: Backend,
        pattern: Pattern,
        structures: Callable[[int], ColumnStructure],
        data: np.ndarray,
        border: tuple[np.ndarray, np.ndarray, np.ndarray],
    ):
        self._backend, self._pattern, self._structures = backend, pattern, structures
        self._data = data
        self._matrix = Bordered(block_matrix(pattern, data), *border)
        self._finite = all(np.all(np.isfinite(a)) for a in (data, *border))
        self._lu = None
        self._sweep: GaussSeidel | None = None
        self._inverses: dict[tuple[bool, bool], Elimination] = {}

    @property
    def nbytes(self) -> int:
        """Memory of the matrix and its factors."""
        parts = (self._matrix, self._lu, self._sweep, *self._inverses.values())
        return sum(part.nbytes for part in parts if part is not None)

    @property
    def is_whole(self) -> bool:
        """Whether the whole matrix has been factorised."""
        return self._lu is not None

    def _nodal(self, direct: bool, transpose: bool):
        """An approximate inverse of the nodal part: LU, or one block Gauss–Seidel sweep."""
        factorise = self._backend.factorise
        if direct:
            if self._lu is None:
                self._lu = factorise(self._structures(self._data.shape[1]), self._data)
            lu, shape = self._lu, (self._pattern.n_nodes, self._data.shape[1])
            return lambda v: lu.solve(v.reshape(shape), transpose).reshape(-1)
        if self._sweep is None:
            groups = self._backend.groups
            self._sweep = GaussSeidel(
                self._pattern, self._data, groups, self._structures, factorise
            )
        sweep = self._sweep
        return lambda v: sweep.apply(v, transpose)

    def inverse(self, transpose: bool = False, direct: bool = False) -> Elimination:
        """The preconditioner; the factors of the whole matrix once there are any.

        **Raises:** `RuntimeError` where a matrix to factorise is exactly singular.
        """
        direct = direct or self._backend.direct or self._lu is not None
        if (direct, transpose) not in self._inverses:
            nodal = self._nodal(direct, transpose)
            self._inverses[direct, transpose] = self._matrix.preconditioner(nodal, transpose)
        return self._inverses[direct, transpose]

    def solve(self, rhs: np.ndarray, transpose: bool, rtol: float) -> tuple[np.ndarray, int, int]:
        """Solution, iterations and outcome; the whole matrix is factorised when GMRES stalls."""
        # Nor is one finite whose square overflows: every comparison of residuals would be true.
        with np.errstate(over="ignore", invalid="ignore"):
            measurable = np.isfinite(np.linalg.norm(rhs))
        if not (self._finite and measurable):
            return np.full_like(rhs, np.nan), 0, NON_FINITE

        def times(v):
            return self._matrix.times(v, transpose)

        iterations, found = 0, None
        direct_at_once = self._backend.direct or self._lu is not None
        for direct in (True,) if direct_at_once else (False, True):
            try:
                inverse = self.inverse(transpose, direct)
            except RuntimeError:  # SuperLU: "Factor is exactly singular"
                continue
            found = flexible_gmres(times, inverse, rhs, rtol)
            iterations += found.iterations
            if found.converged or self._is_at_rounding(found, rhs, transpose):
                return found.x, iterations, SUCCESS
        if found is None or self._lu is None:
            return np.full_like(rhs, np.nan), iterations, SINGULAR
        return found.x, iterations, NOT_CONVERGED

    def _is_at_rounding(self, found, rhs: np.ndarray, transpose: bool) -> bool:
        r"""Whether no better vector is to be had.

        $\|b - Ax\| \le C\epsilon\,\|\,|A||x| + |b|\,\|$ says that x solves a system whose entries
        differ from the given ones by C units of rounding (Rigal, Gaches; Higham (2002), *Accuracy
        and Stability of Numerical Algorithms*, section 7.1), and about that much is lost by
        computing the residual alone. A singular matrix answers with an x so large that its rounding
        hides the right-hand side: its residual is small beside |A||x| only.
        """
        left, b = np.linalg.norm(found.residual), np.linalg.norm(rhs)
        if not left <= LARGEST_RESIDUAL * b:
            return False
        sizes = self._matrix.sizes(found.x, transpose) + abs(rhs)
        return bool(left <= ROUNDING * np.linalg.norm(sizes))

"""What the callbacks call: preconditioned Krylov solves with factorisations kept under handles.

NumPy and SciPy only. A callback that touched JAX could wait for the computation it is part of.
"""

import collections
import itertools
import threading

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from ._direct import ColumnStructure, Pattern, SuperLU
from ._krylov import GaussSeidel, block_matrix

# More iterations than this cost more than a factorisation of the whole system.
MAX_ITERATIONS = 80
SUCCESS, NOT_CONVERGED, SINGULAR, NON_FINITE = range(4)


class Backend:
    """How matrices are factorised: block groups for the preconditioner, and a direct solver."""

    def __init__(self, groups: tuple, direct: bool, factorise=SuperLU):
        self.groups = groups
        self.direct = direct
        self.factorise = factorise


class _Entry:
    """A matrix with whatever has been factorised of it so far."""

    def __init__(
        self, host: "Host", backend: Backend, pattern: Pattern, data: np.ndarray, key: int
    ):
        self._host, self._backend, self._pattern = host, backend, pattern
        self._data, self._key = data, key
        self.matrix = block_matrix(pattern, data)
        self._lu = None
        self._sweep = None

    def _structure(self, n_fields: int) -> ColumnStructure:
        return self._host.structure(self._key, self._pattern, n_fields)

    def _direct(self):
        if self._lu is None:
            structure = self._structure(self._data.shape[1])
            self._lu = self._backend.factorise(structure, self._data)
        return self._lu

    def _preconditioner(self, direct: bool, transpose: bool) -> LinearOperator:
        n, fields = self._pattern.n_nodes, self._data.shape[1]
        if direct or self._lu is not None:
            lu = self._direct()

            def apply(v):
                return lu.solve(v.reshape(n, fields), transpose).reshape(-1)
        else:
            if self._sweep is None:
                self._sweep = GaussSeidel(
                    self._pattern,
                    self._data,
                    self._backend.groups,
                    self._structure,
                    self._backend.factorise,
                )
            sweep = self._sweep

            def apply(v):
                return sweep.apply(v, transpose)

        return LinearOperator(self.matrix.shape, matvec=apply, dtype=float)

    def solve(self, rhs: np.ndarray, transpose: bool, rtol: float):
        """Solution, iterations and outcome; the whole system is factorised when GMRES stalls."""
        if not (np.all(np.isfinite(self._data)) and np.all(np.isfinite(rhs))):
            return np.full_like(rhs, np.nan), 0, NON_FINITE
        matrix = self.matrix.T if transpose else self.matrix
        count = itertools.count()
        for direct in (False, True) if not self._backend.direct else (True,):
            try:
                x, info = gmres(
                    matrix,
                    rhs.reshape(-1),
                    rtol=rtol,
                    atol=0.0,
                    restart=MAX_ITERATIONS // 2,
                    maxiter=2,
                    M=self._preconditioner(direct, transpose),
                    callback=lambda _: next(count),
                    callback_type="pr_norm",
                )
            except RuntimeError:  # SuperLU: "Factor is exactly singular"
                if direct:
                    return np.full_like(rhs, np.nan), next(count), SINGULAR
                continue
            if info == 0:
                break
        outcome = SUCCESS if info == 0 or self._close(matrix, x, rhs, rtol) else NOT_CONVERGED
        return x.reshape(rhs.shape), next(count), outcome

    @staticmethod
    def _close(matrix, x, rhs, rtol) -> bool:
        # Near rounding, GMRES may miss its tolerance by a small factor without a better answer
        # to be had.
        b = rhs.reshape(-1)
        defect = np.linalg.norm(matrix @ x - b)
        floor = 1e-11 * max(np.linalg.norm(b), np.linalg.norm(np.abs(matrix) @ np.abs(x)) * 1e-4)
        return bool(defect <= max(10 * rtol * np.linalg.norm(b), floor))


class Host:
    """Keeps structures and factorisations, the least recently used ones leaving first."""

    def __init__(self, entries: int = 6, structures: int = 24):
        self._entries: collections.OrderedDict = collections.OrderedDict()
        self._structures: collections.OrderedDict = collections.OrderedDict()
        self._limits = entries, structures
        self._handles = itertools.count(1)
        self._lock = threading.RLock()

    def structure(self, key: int, pattern: Pattern, n_fields: int) -> ColumnStructure:
        """Symbolic data of a pattern, computed on first use."""
        with self._lock:
            name = key, n_fields
            if name not in self._structures:
                self._structures[name] = ColumnStructure(pattern, n_fields)
            return _touch(self._structures, name, self._limits[1])

    def prepare(self, backend: Backend, data, pattern_arrays) -> np.ndarray:
        """Announce a matrix; factorisation waits for the first solve."""
        with self._lock:
            handle = next(self._handles)
            self._entries[handle] = self._entry(backend, data, pattern_arrays)
            _touch(self._entries, handle, self._limits[0])
        return np.asarray(handle, np.int64)

    def _entry(self, backend, data, pattern_arrays) -> _Entry:
        indptr, cols, rows, order, key = (np.asarray(a) for a in pattern_arrays)
        pattern = Pattern(indptr, cols, rows, order)
        return _Entry(self, backend, pattern, np.array(data), int(key))

    def solve(self, backend, transpose, rtol, handle, data, rhs, pattern_arrays):
        """Solve with the matrix under `handle`, or with `data` anew if it has left."""
        with self._lock:
            handle = int(handle)
            if handle not in self._entries:
                self._entries[handle] = self._entry(backend, data, pattern_arrays)
            entry = _touch(self._entries, handle, self._limits[0])
            x, iterations, outcome = entry.solve(np.array(rhs), transpose, rtol)
        return x, np.asarray(iterations, np.int32), np.asarray(outcome, np.int32)


def _touch(store: collections.OrderedDict, name, limit: int):
    store.move_to_end(name)
    while len(store) > limit:
        store.popitem(last=False)
    return store[name]


HOST = Host()

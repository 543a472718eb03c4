"""What the callbacks call: preconditioned Krylov solves with factorisations kept under handles.

NumPy and SciPy only. A callback that touched JAX could wait for the computation it is part of.
"""

import collections
import concurrent.futures
import itertools
import os
from collections.abc import Callable

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres
from threadpoolctl import ThreadpoolController

from ._direct import ColumnStructure, Pattern, SuperLU
from ._krylov import Bordered, GaussSeidel, block_matrix

# More iterations than this cost more than a factorisation of the whole system.
MAX_ITERATIONS = 80
MAX_CYCLES = 20
SUCCESS, NOT_CONVERGED, SINGULAR, NON_FINITE = range(4)


class Backend:
    """How matrices are factorised: block groups for the preconditioner, and a direct solver."""

    def __init__(self, groups: tuple, direct: bool, factorise: Callable = SuperLU):
        self.groups = groups
        self.direct = direct
        self.factorise = factorise


class _Entry:
    """A matrix with whatever has been factorised of it so far."""

    def __init__(self, host: "Host", backend: Backend, pattern: Pattern, data, border, key: int):
        self._host, self._backend, self._pattern = host, backend, pattern
        self._data, self._border, self._key = data, border, key
        self._matrix = Bordered(block_matrix(pattern, data), *border)
        self._lu = None
        self._sweep = None
        self._applications: dict = {}

    def _structure(self, n_fields: int) -> ColumnStructure:
        return self._host.structure(self._key, self._pattern, n_fields)

    def _factors(self):
        if self._lu is None:
            structure = self._structure(self._data.shape[1])
            self._lu = self._backend.factorise(structure, self._data)
        return self._lu

    def _nodal(self, direct: bool, transpose: bool):
        """An approximate inverse of the nodal part: LU, or one block Gauss–Seidel sweep."""
        if direct or self._lu is not None:
            lu, shape = self._factors(), (self._pattern.n_nodes, self._data.shape[1])
            return lambda v: lu.solve(v.reshape(shape), transpose).reshape(-1)
        if self._sweep is None:
            self._sweep = GaussSeidel(
                self._pattern,
                self._data,
                self._backend.groups,
                self._structure,
                self._backend.factorise,
            )
        sweep = self._sweep
        return lambda v: sweep.apply(v, transpose)

    def _preconditioner(self, direct: bool, transpose: bool):
        name = direct or self._lu is not None, transpose
        if name not in self._applications:
            nodal = self._nodal(direct, transpose)
            self._applications[name] = self._matrix.preconditioner(nodal, transpose)
        return self._applications[name]

    def solve(self, rhs: np.ndarray, transpose: bool, rtol: float):
        """Solution, iterations and outcome; the whole system is factorised when GMRES stalls."""
        finite = all(np.all(np.isfinite(a)) for a in (self._data, rhs, *self._border))
        if not finite:
            return np.full_like(rhs, np.nan), 0, NON_FINITE
        shape = 2 * rhs.shape

        def times(v):
            return self._matrix.times(v, transpose)

        iterations: list[float] = []
        x, info = rhs, 1
        for direct in (True,) if self._backend.direct else (False, True):
            try:
                preconditioner = self._preconditioner(direct, transpose)
            except RuntimeError:  # SuperLU: "Factor is exactly singular"
                if direct:
                    return np.full_like(rhs, np.nan), len(iterations), SINGULAR
                continue
            x, info = _gmres(
                LinearOperator(shape, matvec=times, dtype=float),  # pyright: ignore
                LinearOperator(shape, matvec=preconditioner, dtype=float),  # pyright: ignore
                rhs,
                rtol,
                iterations,
            )
            if info == 0:
                break
        if info != 0 and not self._is_at_rounding(times(x) - rhs, rhs, x, rtol):
            return x, len(iterations), NOT_CONVERGED
        return x, len(iterations), SUCCESS

    def _is_at_rounding(self, defect, rhs, x, rtol) -> bool:
        # Near rounding GMRES may miss its tolerance by a little with no better answer to be had.
        # An x so large that its rounding hides the right-hand side belongs to a singular matrix.
        b = np.linalg.norm(rhs)
        floor = min(1e-14 * np.max(np.abs(self._data)) * np.linalg.norm(x), 1e-3 * b)
        return bool(np.linalg.norm(defect) <= max(10 * rtol * b, floor))


def _gmres(matrix, preconditioner, rhs: np.ndarray, rtol: float, iterations: list[float]):
    """Solution and 0, or the best that there is and 1; residual norms are appended.

    A cycle ends early when the *preconditioned* residual is small; whether the true one is small is
    seen only then, and the next cycle goes on. Many short cycles are normal on fine meshes, so that
    their number is not limited, only that of all iterations together. The last iterate is kept even
    when it misses the tolerance: rounding may let no better one be had.
    """
    allowed, x = len(iterations) + MAX_ITERATIONS, None
    for _ in range(MAX_CYCLES):
        x, info = gmres(
            matrix,
            rhs,
            x0=x,
            rtol=rtol,
            atol=0.0,
            restart=MAX_ITERATIONS // 2,
            maxiter=1,
            M=preconditioner,
            callback=iterations.append,
            callback_type="pr_norm",
        )
        if info == 0:
            return x, 0
        if len(iterations) >= allowed:
            break
    return x, 1


class Host:
    """Keeps structures and factorisations, the least recently used ones leaving first.

    All work is done by one thread. Callbacks arrive on whatever thread the runtime chooses, and
    SciPy frees the memory of a SuperLU object only on the thread that made it: elsewhere every
    factorisation would leak. OpenBLAS works on one thread meanwhile: it splits the inner products
    of GMRES from 10,000 entries on, and its threads wait for each other longer than they compute
    (two to five times the time of a solve on a busy machine).
    """

    def __init__(self, entries: int = 6, structures: int = 24):
        self._entries: collections.OrderedDict = collections.OrderedDict()
        self._structures: collections.OrderedDict = collections.OrderedDict()
        self._limits = entries, structures
        self._handles = itertools.count(1)
        self._worker: concurrent.futures.ThreadPoolExecutor | None = None
        self._process = -1
        self._blas = ThreadpoolController().select(internal_api="openblas")

    def _call(self, work, *args):
        # Threads do not survive a fork, so a child process starts its own.
        if self._worker is None or self._process != os.getpid():
            self._worker = concurrent.futures.ThreadPoolExecutor(1, "jaxwillmore-linalg")
            self._process = os.getpid()
        return self._worker.submit(self._on_one_thread, work, *args).result()

    def _on_one_thread(self, work, *args):
        with self._blas.limit(limits=1):
            return work(*args)

    def structure(self, key: int, pattern: Pattern, n_fields: int) -> ColumnStructure:
        """Symbolic data of a pattern, computed on first use."""
        name = key, n_fields
        if name not in self._structures:
            self._structures[name] = ColumnStructure(pattern, n_fields)
        return _touch(self._structures, name, self._limits[1])

    def prepare(self, backend: Backend, data, border, pattern_arrays) -> np.ndarray:
        """Announce a matrix; factorisation waits for the first solve."""
        arrays = _host_arrays(data, border, pattern_arrays)
        return np.asarray(self._call(self._prepare, backend, *arrays), np.int64)

    def _prepare(self, backend, data, border, pattern_arrays) -> int:
        handle = next(self._handles)
        self._entries[handle] = self._entry(backend, data, border, pattern_arrays)
        _touch(self._entries, handle, self._limits[0])
        return handle

    def _entry(self, backend, data, border, pattern_arrays) -> _Entry:
        *arrays, key = pattern_arrays
        copies = tuple(np.array(a) for a in border)
        return _Entry(self, backend, Pattern(*arrays), np.array(data), copies, int(key))

    def solve(self, backend, transpose, rtol, handle, data, border, rhs, pattern_arrays):
        """Solve with the matrix under `handle`, or with `data` anew if it has left."""
        arrays = _host_arrays(data, border, pattern_arrays)
        return self._call(
            self._solve, backend, transpose, rtol, int(handle), np.array(rhs), *arrays
        )

    def _solve(self, backend, transpose, rtol, handle, rhs, data, border, pattern_arrays):
        if handle not in self._entries:
            self._entries[handle] = self._entry(backend, data, border, pattern_arrays)
        entry = _touch(self._entries, handle, self._limits[0])
        x, iterations, outcome = entry.solve(rhs, transpose, rtol)
        return x, np.asarray(iterations, np.int32), np.asarray(outcome, np.int32)


def _host_arrays(data, border, pattern_arrays):
    return (
        np.asarray(data),
        tuple(np.asarray(a) for a in border),
        tuple(np.asarray(a) for a in pattern_arrays),
    )


def _touch(store: collections.OrderedDict, name, limit: int):
    store.move_to_end(name)
    while len(store) > limit:
        store.popitem(last=False)
    return store[name]


HOST = Host()

"""What callbacks and host solvers call: factorised matrices kept under handles.

NumPy and SciPy only. A callback that touched JAX could wait for the computation it is part of.
"""

import collections
import itertools

import numpy as np

from ._direct import ColumnStructure, Pattern
from ._factorised import Backend, Factorised
from ._threads import WORKER

# A run needs one factorised matrix at a time, and the reverse pass of a replay each of them once;
# a batch under `vmap` needs one per member.
ENTRIES = 256 * 2**20
STRUCTURES = 128 * 2**20


class Store:
    """Values under names. The least recently used leave when all together hold too many bytes.

    The one that was used last stays, whatever its size.
    """

    def __init__(self, limit: int):
        self._limit = limit
        self._values: collections.OrderedDict = collections.OrderedDict()

    def __contains__(self, name) -> bool:
        return name in self._values

    def __len__(self) -> int:
        return len(self._values)

    def __getitem__(self, name):
        self._values.move_to_end(name)
        return self._values[name]

    def __setitem__(self, name, value):
        self._values[name] = value
        self.trim()

    @property
    def nbytes(self) -> int:
        """Memory of all values; values grow when they are used."""
        return sum(value.nbytes for value in self._values.values())

    def trim(self):
        """Let values leave until the rest is within the limit."""
        excess = self.nbytes - self._limit
        while excess > 0 and len(self._values) > 1:
            excess -= self._values.popitem(last=False)[1].nbytes

    def clear(self):
        """Forget everything."""
        self._values.clear()


class Host:
    """Keeps structures and factorised matrices. All work is done by the one `WORKER`.

    Matrices come in two ways. Traced code announces them (`prepare`) and passes handle *and* data
    to `solve`: whatever has left meanwhile is factorised again. Host solvers `hold` a matrix until
    they `release` it; it never leaves.
    """

    def __init__(self, entries: int = ENTRIES, structures: int = STRUCTURES):
        self._entries, self._structures = Store(entries), Store(structures)
        self._held: dict[int, Factorised] = {}
        self._released: collections.deque[int] = collections.deque()
        self._handles = itertools.count(1)

    @property
    def nbytes(self) -> int:
        """Memory of everything that is kept."""
        held = sum(matrix.nbytes for matrix in list(self._held.values()))
        return self._entries.nbytes + self._structures.nbytes + held

    def run(self, work, *args):
        """The result of `work(*args)` on the worker."""
        return WORKER.run(self._after_release, work, *args)

    def _after_release(self, work, *args):
        while self._released:
            self._held.pop(self._released.popleft(), None)
        return work(*args)

    def structure(self, key: int, pattern: Pattern, n_fields: int) -> ColumnStructure:
        """Symbolic data of a pattern, computed on first use."""
        name = key, n_fields
        if name not in self._structures:
            self._structures[name] = ColumnStructure(pattern, n_fields)
        return self._structures[name]

    def _factorised(self, backend, data, border, pattern_arrays) -> Factorised:
        *arrays, key = pattern_arrays
        pattern, key = Pattern(*arrays), int(key)

        def structures(n_fields):
            return self.structure(key, pattern, n_fields)

        return Factorised(backend, pattern, structures, data, border)

    def prepare(self, backend: Backend, data, border, pattern_arrays) -> np.ndarray:
        """Announce a matrix; factorisation waits for the first solve."""
        arrays = _host_arrays(data, border, pattern_arrays)
        return np.asarray(self.run(self._prepare, backend, *arrays), np.int64)

    def _prepare(self, backend, data, border, pattern_arrays) -> int:
        handle = next(self._handles)
        self._entries[handle] = self._factorised(backend, data, border, pattern_arrays)
        return handle

    def solve(self, backend, transpose, rtol, handle, data, border, rhs, pattern_arrays):
        """Solve with the matrix under `handle`, or with `data` anew if it has left."""
        arrays = _host_arrays(data, border, pattern_arrays)
        return self.run(
            self._solve, backend, transpose, rtol, int(handle), np.asarray(rhs), *arrays
        )

    def _solve(self, backend, transpose, rtol, handle, rhs, data, border, pattern_arrays):
        if handle not in self._entries:
            self._entries[handle] = self._factorised(backend, data, border, pattern_arrays)
        x, iterations, outcome = self._entries[handle].solve(rhs, transpose, rtol)
        self._entries.trim()
        return x, np.asarray(iterations, np.int32), np.asarray(outcome, np.int32)

    def hold(self, backend: Backend, data, border, pattern_arrays) -> int:
        """Keep a matrix until it is released."""
        return self.run(self._hold, backend, *_host_arrays(data, border, pattern_arrays))

    def _hold(self, *args) -> int:
        handle = next(self._handles)
        self._held[handle] = self._factorised(*args)
        return handle

    def held(self, handle: int) -> Factorised | None:
        """The matrix under a handle of `hold`; nothing once it has been freed."""
        return self._held.get(handle)

    def release(self, handle: int):
        """Let a matrix go, with the next work at the latest.

        Never waits: it is called by the garbage collector, on any thread.
        """
        self._released.append(handle)

    def free(self):
        """Let go now of what has been released; not for a garbage collector, it may wait."""
        self.run(lambda: None)

    def clear(self):
        """Forget all matrices, held ones too, and all structures."""
        self.run(self._clear)

    def _clear(self):
        for store in (self._entries, self._structures, self._held):
            store.clear()


def _host_arrays(data, border, pattern_arrays):
    # Views: an array that JAX hands to a callback is immutable, and lives as long as a view of it.
    return (
        np.asarray(data),
        tuple(np.asarray(a) for a in border),
        tuple(np.asarray(a) for a in pattern_arrays),
    )


HOST = Host()


def clear():
    """Free all memory that sparse solves keep: matrices, factors and symbolic data.

    Nothing is lost but time: the next solve computes again what it needs.
    """
    HOST.clear()

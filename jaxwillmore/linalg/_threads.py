"""One worker thread for SuperLU, and OpenBLAS on one thread while anything is solved."""

import concurrent.futures
import contextlib
import os
import threading
from collections.abc import Callable

from threadpoolctl import ThreadpoolController


class Worker:
    """Runs everything on one thread of its own, with OpenBLAS on one thread meanwhile.

    Callbacks arrive on whatever thread the runtime chooses, and SciPy frees the memory of a SuperLU
    object only on the thread that made it: elsewhere every factorisation would leak.

    OpenBLAS splits the inner products of GMRES from 10,000 entries on, and many small products, and
    its threads wait for each other longer than they compute (two to five times the time of a solve
    on a busy machine). The number of its threads belongs to the whole process, and threadpoolctl
    lets one thread at a time change it: the worker does, from the first that enters to the last
    that leaves.
    """

    def __init__(self):
        self._blas = ThreadpoolController().select(internal_api="openblas")
        self._on_worker = threading.local()
        self.forget()

    def forget(self):
        """Begin anew, in a child process: threads do not survive a fork."""
        self._lock, self._executor = threading.Lock(), None
        self._inside, self._limits = 0, contextlib.ExitStack()

    def run(self, work: Callable, *args):
        """The result of `work(*args)`, computed on the worker."""
        if getattr(self._on_worker, "here", False):
            return work(*args)
        with self._lock:
            if self._executor is None:
                self._executor = concurrent.futures.ThreadPoolExecutor(1, "jaxwillmore-linalg")
            future = self._executor.submit(self._limited, work, *args)
        return future.result()

    def _limited(self, work, *args):
        self._on_worker.here = True
        self.enter()
        try:
            return work(*args)
        finally:
            self.leave()

    def enter(self):
        """On the worker: OpenBLAS on one thread until as many have left as have entered."""
        if self._inside == 0:
            self._limits.enter_context(self._blas.limit(limits=1))
        self._inside += 1

    def leave(self):
        """On the worker: the end of what `enter` began."""
        self._inside -= 1
        if self._inside == 0:
            self._limits.close()


WORKER = Worker()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=WORKER.forget)


@contextlib.contextmanager
def one_blas_thread():
    """Inside, OpenBLAS works on one thread on all threads; afterwards on as many as before."""
    WORKER.run(WORKER.enter)
    try:
        yield
    finally:
        WORKER.run(WORKER.leave)

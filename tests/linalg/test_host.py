"""What the host keeps, for how long, and on which threads it works."""

import gc
import os
import threading

import jax
import jax.numpy as jnp
import jax.random as jr
import lineax as lx
import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

from jaxwillmore import linalg
from jaxwillmore.linalg import HostMatrix, SparseOperator, SparseSolver
from jaxwillmore.linalg._host import HOST, Store
from jaxwillmore.linalg._threads import WORKER, Worker, one_blas_thread

from .systems import dense, random_blocks, random_border, sphere_pattern

PATTERN, FIELDS = sphere_pattern(), 2
GROUPS = (((0,),), ((1,),))
b = np.random.default_rng(0).normal(size=PATTERN.n_nodes * FIELDS)


def matrix(key=0, groups=GROUPS, method="krylov") -> HostMatrix:
    return HostMatrix(PATTERN, random_blocks(jr.key(key), PATTERN, FIELDS), None, groups, method)


class Sized:
    def __init__(self, nbytes):
        self.nbytes = nbytes


def test_a_store_holds_bytes_and_lets_the_least_recently_used_leave():
    store = Store(100)
    store["a"], store["b"] = Sized(40), Sized(40)
    assert store["a"].nbytes == 40  # used
    store["c"] = Sized(40)
    assert "b" not in store and store.nbytes == 80
    store["a"].nbytes = 70  # values grow when they are factorised
    store.trim()
    assert "c" not in store and "a" in store
    store["d"] = Sized(1000)
    assert "d" in store and len(store) == 1  # the newest stays, whatever its size


@pytest.mark.parametrize("method", ["krylov", "direct"])
@pytest.mark.parametrize("n_globals", [0, 2])
def test_a_host_matrix_solves_and_so_does_its_transpose(method, n_globals):
    border = random_border(jr.key(7), PATTERN, FIELDS, n_globals)
    data = random_blocks(jr.key(0), PATTERN, FIELDS)
    full = dense(SparseOperator(data, PATTERN, border))
    arrays = border.columns, border.rows, border.corner
    held = HostMatrix(PATTERN, data, arrays, GROUPS, method)
    rhs = np.random.default_rng(1).normal(size=len(full))
    for transpose, A in ((False, full), (True, full.T)):
        x, iterations, failure = held.solve(rhs, 1e-13, transpose)
        assert not failure and iterations > 0
        np.testing.assert_allclose(x, np.linalg.solve(A, rhs), atol=1e-11)


def test_factors_go_with_the_matrix():
    linalg.clear()
    first = matrix()
    first.solve(b, 1e-8)
    full = HOST.nbytes
    second = matrix(1)
    second.solve(b, 1e-8)
    first.release()
    assert not first.alive and second.alive
    # At once: what is assembled next would stand beside it.
    assert HOST.nbytes == full
    with pytest.raises(ValueError, match="has been released"):
        first.solve(b, 1e-8)
    del second
    gc.collect()
    HOST.run(lambda: None)  # what the collector releases waits for the next work
    assert HOST.nbytes < full


def test_clear_frees_everything_and_nothing_is_lost():
    held = matrix()
    held.solve(b, 1e-8)
    operator = SparseOperator(random_blocks(jr.key(0), PATTERN, FIELDS), PATTERN)
    solver = SparseSolver(GROUPS, 1e-12)
    state = solver.init(operator, {})
    before = lx.linear_solve(operator, jnp.asarray(b), solver, state=state).value
    linalg.clear()
    assert HOST.nbytes == 0 and not held.alive
    after = lx.linear_solve(operator, jnp.asarray(b), solver, state=state).value
    np.testing.assert_array_equal(after, before)


def test_matrices_are_kept_without_a_copy():
    data = np.asarray(random_blocks(jr.key(0), PATTERN, FIELDS))
    held = HostMatrix(PATTERN, data, None, GROUPS)
    stored = held._held()._matrix._matrix.matrix.data
    assert np.shares_memory(stored, data)
    held.solve(b, 1e-8, transpose=True)
    assert held.nbytes > 2 * data.nbytes  # the transposed copy and the factors count


def test_what_a_callback_receives_is_never_overwritten():
    """The host keeps views of what JAX hands to it."""
    seen = []

    def keep(a):
        seen.append((np.asarray(a), np.array(a)))
        return np.float64(0.0)

    @jax.jit
    def f(a):
        for k in range(3):
            a = jnp.sin(a) + k + jax.pure_callback(keep, jax.ShapeDtypeStruct((), float), a)
        return a

    rng = np.random.default_rng(0)
    for size in (10, 100_000):
        for _ in range(4):
            f(jnp.asarray(rng.normal(size=size))).block_until_ready()
            gc.collect()
    assert len(seen) == 24
    for view, copy in seen:
        np.testing.assert_array_equal(view, copy)


# Threads.


def blas_threads() -> list[int]:
    controller = ThreadpoolController().select(internal_api="openblas")
    return [library["num_threads"] for library in controller.info()]


def test_openblas_works_on_one_thread_inside_and_on_as_many_as_before_outside():
    before = blas_threads()
    assert all(n == 1 for n in HOST.run(blas_threads))
    assert blas_threads() == before
    with one_blas_thread():
        HOST.run(lambda: None)
        assert all(n == 1 for n in blas_threads())
    assert blas_threads() == before


def test_solves_that_overlap_restore_the_number_of_threads():
    """First in, first out: saving and restoring in each would end at one thread."""
    before = blas_threads()
    entered, leave = threading.Event(), threading.Event()

    def first():
        with one_blas_thread():
            entered.set()
            leave.wait()

    thread = threading.Thread(target=first)
    thread.start()
    entered.wait()
    with one_blas_thread():
        leave.set()
        thread.join()
        assert all(n == 1 for n in blas_threads())
    assert blas_threads() == before


def test_many_threads_make_one_worker():
    worker, names = Worker(), set()
    barrier = threading.Barrier(8)

    def call():
        barrier.wait()
        names.add(worker.run(threading.get_ident))

    threads = [threading.Thread(target=call) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(names) == 1


def test_work_on_the_worker_may_ask_for_more_work():
    assert WORKER.run(lambda: WORKER.run(lambda: 3)) == 3


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::RuntimeWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_child_process_starts_its_own_worker():
    assert WORKER.run(lambda: 1) == 1
    child = os.fork()
    if child == 0:
        os._exit(WORKER.run(lambda: 7))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7

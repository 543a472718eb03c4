"""SparseSolver: the Lineax solver behind every implicit step."""

import functools as ft
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import lineax as lx
import numpy as np
from jaxtyping import Array, Float, Int

from ._dense import DenseFactors, dense_factors
from ._factorised import backend
from ._host import HOST
from ._host_matrix import FAILURES, pattern_arrays
from ._methods import checked_method
from ._operator import SparseOperator
from ._system import AbstractSparseSystem


def _border(operator: SparseOperator):
    return operator.border.columns, operator.border.rows, operator.border.corner


class PreparedMatrix(eqx.Module):
    """A matrix that the host knows under `handle`."""

    handle: Int[Array, ""]
    operator: SparseOperator

    def transpose(self) -> "PreparedMatrix":
        """The same matrix, for the transposed system."""
        return PreparedMatrix(self.handle, self.operator.transpose())


class SparseSolver(lx.AbstractLinearSolver):
    """Solves with a `SparseOperator`, or with the Jacobian of an `AbstractSparseSystem`.

    The work happens in one host callback per solve: flexible GMRES with a block Gauss–Seidel
    preconditioner; if that does not converge, sparse LU of the whole system in nested-dissection
    order. With `"dense"` there is no callback: small systems are solved where the program runs,
    all members of a `vmap` at once. Derivatives, forward and reverse, are solves with the same
    matrix or its transpose.

    **Arguments:**

    - `groups`: for the preconditioner, groups of columns in order of solution; a group is a tuple
      of copies (tuples of columns) that share one factorisation, or a `TangentGroup`. Empty: no
      preconditioner, LU at once.
    - `rtol`: relative residual asked of GMRES. Where rounding forbids it, a residual at the level
      of rounding is taken that is at most 1e-6.
    - `method`: `"krylov"` (as above), `"direct"` (SuperLU at once), `"dense"` (LAPACK's LU or the
      device's, for at most 2,500 unknowns) or `"pardiso"` (MKL Pardiso at once; needs the extra
      `fast`).

    **Raises:** `ValueError` for an unknown method, for `"pardiso"` where it is not installed, and
    for `"dense"` beyond its limit.

    *Limits:* real 64-bit matrices. Under `vmap`, members are solved one after another, except by
    `"dense"`.
    """

    groups: tuple = eqx.field(static=True, default=())
    rtol: float = eqx.field(static=True, default=1e-8)
    method: str = eqx.field(static=True, default="krylov")

    def __check_init__(self):
        checked_method(self.method)

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]):
        del options
        operator = _assembled(operator)
        operator = jax.lax.stop_gradient(operator)
        if self.method == "dense":
            return dense_factors(operator)
        handle = jax.pure_callback(
            ft.partial(HOST.prepare, backend(self.groups, self.method)),
            jax.ShapeDtypeStruct((), jnp.int64),
            operator.data,
            _border(operator),
            pattern_arrays(operator.pattern),
            vmap_method="sequential",
        )
        return PreparedMatrix(handle, operator)

    def unprepared(self, operator: SparseOperator) -> "PreparedMatrix | DenseFactors":
        """What `init` returns, in shape alone: a state to replace before the first solve."""
        if self.method == "dense":
            return DenseFactors.unprepared(operator)
        return PreparedMatrix(jnp.asarray(0, jnp.int64), operator)

    def compute(self, state, vector: Float[Array, " unknowns"], options):
        del options
        if isinstance(state, DenseFactors):
            return state.solve(vector, self.rtol)
        operator = state.operator
        x, iterations, outcome = jax.pure_callback(
            ft.partial(
                HOST.solve, backend(self.groups, self.method), operator.transposed, self.rtol
            ),
            (
                jax.ShapeDtypeStruct(vector.shape, vector.dtype),
                jax.ShapeDtypeStruct((), np.int32),
                jax.ShapeDtypeStruct((), np.int32),
            ),
            state.handle,
            operator.data,
            _border(operator),
            vector,
            pattern_arrays(operator.pattern),
            vmap_method="sequential",
        )
        result = lx.RESULTS.successful
        for code, failure in FAILURES.items():
            result = lx.RESULTS.where(outcome == code, failure, result)
        return x, result, {"iterations": iterations}

    def transpose(self, state, options: dict[str, Any]):
        return state.transpose(), options

    def conj(self, state, options: dict[str, Any]):
        return state, options

    def assume_full_rank(self):
        return True


def _assembled(operator: lx.AbstractLinearOperator) -> SparseOperator:
    """The sparse matrix of an operator.

    The implicit adjoint of Optimistix hands over an opaque Jacobian at the root; the system that
    it came from travels among its arguments and assembles the same matrix.
    """
    if isinstance(operator, SparseOperator):
        return operator
    if isinstance(operator, lx.JacobianLinearOperator):
        leaves = jtu.tree_leaves(
            operator.args, is_leaf=lambda leaf: isinstance(leaf, AbstractSparseSystem)
        )
        systems = [leaf for leaf in leaves if isinstance(leaf, AbstractSparseSystem)]
        if len(systems) == 1:
            return systems[0].jacobian(operator.x)
    raise ValueError(
        f"SparseSolver solves with a SparseOperator, or with the Jacobian of a residual whose "
        f"`args` is one AbstractSparseSystem; got {type(operator).__name__}."
    )

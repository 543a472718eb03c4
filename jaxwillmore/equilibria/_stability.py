"""Stability of an equilibrium: negative directions of the constrained second variation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float
from scipy.sparse.linalg import LinearOperator, eigsh

from ..linalg import SparseOperator, SparseSolver
from ._functional import N_GLOBALS, EquilibriumSystem


def lowest_modes(
    system: EquilibriumSystem,
    unknowns: Float[Array, " unknowns"],
    count: int = 8,
    linear_solver: str = "direct",
) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, "nodes modes"]]:
    r"""The lowest eigenvalues of the constrained second variation.

    With C the rows of the constraints that are held (area, volume) and S the second variation by
    normal displacements (y eliminated, the six rigid motions made stiff): $S s = \lambda M s$ on
    $C s = 0$. One factorisation of the saddle-point matrix with $S + cM$ in place of S applies the
    inverse on the constrained space; Lanczos (ARPACK) on it finds the smallest $\lambda + c$.

    **Returns:**

    Eigenvalues in units of $\kappa/R_0^4$, ascending; modes as columns of normal displacements.

    *Limits:* eigenvalues below $-c$ with $c = 50\,(10 + |\hat\sigma| + |\hat P|)$ would be missed.
    """
    g = system.unpack(unknowns)[2]
    shift = 50.0 * (10.0 + float(jnp.abs(g[0]) + jnp.abs(g[1])))
    r = system.reference
    n = r.X.shape[0]
    solver = SparseSolver(rtol=1e-10, method=linear_solver)
    operator = _shifted(system, unknowns, jnp.asarray(shift))
    state = solver.init(operator, {})
    M = sp.csr_matrix(
        (np.asarray(r.mass), np.asarray(r.pattern.cols), np.asarray(r.pattern.indptr)), (n, n)
    )

    def inverse(b):
        return np.asarray(_applied(operator, state, solver, jnp.asarray(b)))

    def operator_of(matvec):
        return LinearOperator((n, n), matvec=matvec, dtype=float)  # pyright: ignore

    # ARPACK never multiplies by its first argument in shift-invert mode.
    values, modes = eigsh(
        operator_of(lambda b: b),
        count,
        M=M,
        sigma=-shift,
        OPinv=operator_of(inverse),
        which="LA",
        v0=np.cos(1.7 * np.arange(n)) + 0.3,
        ncv=4 * count,
        tol=1e-8,  # pyright: ignore
    )
    order = np.argsort(values)
    return values[order], modes[:, order]


@eqx.filter_jit
def _shifted(system, unknowns, shift) -> SparseOperator:
    """The saddle-point matrix with $cM$ added to S and the path parameter held."""
    path = system.path
    held = eqx.tree_at(
        lambda s: (s.inverse_tau, s.path.shape, s.path.weight),
        system,
        (shift, jnp.zeros_like(path.shape), jnp.ones_like(path.weight)),
    )
    return held.jacobian(unknowns)


@eqx.filter_jit
def _applied(operator, state, solver, b):
    n = b.shape[0]
    rhs = jnp.concatenate([jnp.zeros((n, 4)).at[:, 0].set(b).reshape(-1), jnp.zeros(N_GLOBALS)])
    solution = lx.linear_solve(operator, rhs, solver, state=state, throw=False)
    return jax.lax.stop_gradient(solution.value)[: 4 * n].reshape(n, 4)[:, 0]

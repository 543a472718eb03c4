"""Stability of an equilibrium: negative directions of the constrained second variation."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float
from scipy.sparse.linalg import LinearOperator, eigsh

from ..linalg import HostMatrix
from ._density import PRESSURE, TENSION
from ._functional import EquilibriumSystem
from ._solve import arrays_of, jacobian_of


def lowest_modes(
    system: EquilibriumSystem,
    unknowns: Float[Array, " unknowns"],
    count: int = 8,
    linear_solver: str = "direct",
) -> tuple[Float[np.ndarray, " modes"], Float[np.ndarray, "components modes"]]:
    r"""The lowest eigenvalues of the constrained second variation.

    With C the rows of the constraints that are held (area, volume) and S the second variation by
    normal displacements (y eliminated, the six rigid motions made stiff): $S s = \lambda M s$ on
    $C s = 0$. One factorisation of the saddle-point matrix with $S + cM$ in place of S applies the
    inverse on the constrained space; Lanczos (ARPACK) on it finds the smallest $\lambda + c$.

    With a concentration the variation is by $(s, c)$, the amount is held too, and M measures a
    change of $c$ by one like a displacement by the unit of length.

    **Returns:**

    Eigenvalues in units of $\kappa/R_0^4$, ascending; modes as columns of normal displacements,
    below them the changes of the concentration if there is one.

    *Limits:* eigenvalues below $-c$ with $c = 50\,(10 + |\hat\sigma| + |\hat P|)$ would be missed;
    those of a quartic well are above $-3\hat\lambda/\hat\ell$.
    """
    r, g = system.reference, system.unpack(unknowns)[2]
    shift = 50.0 * (10.0 + float(jnp.abs(g[TENSION]) + jnp.abs(g[PRESSURE])))
    n = r.X.shape[0] * (2 if system.has_phases else 1)
    matrix = HostMatrix(
        system.pattern,
        *arrays_of(jacobian_of(_shifted(system, jnp.asarray(shift, float)), unknowns)),
        (),
        linear_solver,
    )
    fields = [0, 4] if system.has_phases else [0]
    entries = (np.asarray(a) for a in (r.mass, r.pattern.cols, r.pattern.indptr))
    M = sp.csr_matrix(tuple(entries))
    M = sp.block_diag([M, M], "csr") if system.has_phases else M

    def inverse(b):
        nodal = np.zeros((len(r.X), system.n_fields))
        nodal[:, fields] = b.reshape(len(fields), -1).T
        rhs = np.concatenate([nodal.reshape(-1), np.zeros(system.n_globals)])
        found = matrix.solve(rhs, 1e-10)[0][: nodal.size]
        return found.reshape(nodal.shape)[:, fields].T.reshape(-1)

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
    matrix.release()
    order = np.argsort(values)
    return values[order], modes[:, order]


def _shifted(system: EquilibriumSystem, shift) -> EquilibriumSystem:
    """The system whose matrix has $cM$ added to S, and the path parameter held.

    It differs in values alone: the compiled Jacobian of the solve serves it too.
    """
    path = system.path
    return eqx.tree_at(
        lambda s: (s.inverse_tau, s.path.shape, s.path.weight),
        system,
        (shift, jnp.zeros_like(path.shape), jnp.ones_like(path.weight)),
    )

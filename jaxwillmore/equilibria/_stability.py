"""Stability of an equilibrium: the constrained second variation and its lowest modes."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.sparse.linalg import LinearOperator, eigsh

from ..linalg import HostMatrix
from ._density import PRESSURE, TENSION
from ._functional import EquilibriumSystem
from ._solve import arrays_of, jacobian_of


class SecondVariation:
    r"""The constrained second variation at a stationary point, factorised.

    With C the rows of the constraints that are held (area, volume) and S the second variation by
    normal displacements (y eliminated, the six rigid motions made stiff): $S s = \lambda M s$ on
    $C s = 0$. One factorisation of the saddle-point matrix with $S + cM$ in place of S applies the
    inverse on the constrained space; Lanczos (ARPACK) on it finds the smallest $\lambda + c$.

    With a concentration the variation is by $(s, c)$, the amount is held too, and M measures a
    change of $c$ by one like a displacement by the unit of length.

    *Limits:* eigenvalues below $-c$ with $c = 50\,(10 + |\hat\sigma| + |\hat P|)$ would be missed;
    those of a quartic well are above $-3\hat\lambda/\hat\ell$.
    """

    def __init__(self, system: EquilibriumSystem, unknowns, linear_solver: str = "direct"):
        self._system, g = system, system.unpack(unknowns)[2]
        self._fields = [0, 4] if system.has_phases else [0]
        self._shift = 50.0 * (10.0 + float(jnp.abs(g[TENSION]) + jnp.abs(g[PRESSURE])))
        shifted = _shifted(system, jnp.asarray(self._shift, float))
        blocks, border = arrays_of(jacobian_of(shifted, unknowns))
        self._matrix = HostMatrix(system.pattern, blocks, border, (), linear_solver)
        r = system.reference
        entries = (np.asarray(a) for a in (r.mass, r.pattern.cols, r.pattern.indptr))
        M = sp.csr_matrix(tuple(entries))
        self._mass = sp.block_diag([M, M], "csr") if system.has_phases else M
        self._size = len(r.X) * len(self._fields)

    def release(self) -> None:
        """Free the factors."""
        self._matrix.release()

    def _solved(self, b) -> Float[np.ndarray, " unknowns"]:
        nodal = np.zeros((self._size // len(self._fields), self._system.n_fields))
        nodal[:, self._fields] = b.reshape(len(self._fields), -1).T
        rhs = np.concatenate([nodal.reshape(-1), np.zeros(self._system.n_globals)])
        return self._matrix.solve(rhs, 1e-10)[0]

    def _varied(self, unknowns):
        nodal = unknowns[: -self._system.n_globals].reshape(-1, self._system.n_fields)
        return nodal[:, self._fields].T.reshape(-1)

    def lowest(self, count: int = 8) -> tuple[np.ndarray, np.ndarray]:
        r"""The lowest eigenvalues in units of $\kappa/R_0^4$, ascending, and their modes.

        Modes are columns of normal displacements, below them the changes of the concentration if
        there is one; M-orthonormal.
        """
        n = self._size

        def operator_of(matvec):
            return LinearOperator((n, n), matvec=matvec, dtype=float)  # pyright: ignore

        # ARPACK never multiplies by its first argument in shift-invert mode.
        values, modes = eigsh(
            operator_of(lambda b: b),
            count,
            M=self._mass,
            sigma=-self._shift,
            OPinv=operator_of(lambda b: self._varied(self._solved(b))),
            which="LA",
            v0=np.cos(1.7 * np.arange(n)) + 0.3,
            ncv=4 * count,
            tol=1e-8,  # pyright: ignore
        )
        order = np.argsort(values)
        return values[order], modes[:, order]

    def completed(self, value: float, mode) -> Float[np.ndarray, " unknowns"]:
        """All unknowns that belong to a mode: $y$ and the multipliers that go with it."""
        return (value + self._shift) * self._solved(self._mass @ mode)


def lowest_eigenvalues(
    system: EquilibriumSystem, unknowns, count: int, linear_solver: str
) -> tuple[float, ...]:
    """Those of the constrained second variation, ascending."""
    variation = SecondVariation(system, unknowns, linear_solver)
    values, _ = variation.lowest(count)
    variation.release()
    return tuple(float(value) for value in values)


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

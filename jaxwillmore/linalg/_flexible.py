"""Flexible GMRES by SciPy, with what it does counted. NumPy and SciPy only."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import LinearOperator, gcrotmk

# More iterations than this cost more than a factorisation of the whole system.
MAX_ITERATIONS = 80
RESTART = 40
# A cycle that reduces the residual by less has come to rounding, or leads nowhere.
STALLED = 0.5


class Krylov(NamedTuple):
    """The best vector found, the sweeps it took, and what is left of the right-hand side."""

    x: np.ndarray
    iterations: int
    residual: np.ndarray
    converged: bool


def flexible_gmres(times: Callable, precondition: Callable, rhs: np.ndarray, rtol: float) -> Krylov:
    r"""Solve $Ax = b$ until $\|b - Ax\| \le$ `rtol` $\|b\|$, or until it stalls.

    Preconditioned from the right, so that the residual it watches is the true one, and flexible:
    the preconditioned vectors are stored, so that the solution is a sum of them. One sweep and one
    product per iteration, one more product per cycle to see the true residual (SciPy's `gmres`
    sweeps twice more in every cycle). SciPy's `gcrotmk` that carries no vectors from cycle to
    cycle *is* FGMRES.

    **Arguments:**

    - `times`, `precondition`: the products with $A$ and with an approximate inverse.

    ??? cite "Reference"
        Saad (1993), *SIAM J. Sci. Comput.* 14, 461–469.
    """
    iterations = 0

    def sweep(vector):
        nonlocal iterations
        iterations += 1
        return precondition(vector)

    shape = 2 * rhs.shape
    A = LinearOperator(shape, matvec=times, dtype=float)  # pyright: ignore[reportCallIssue]
    P = LinearOperator(shape, matvec=sweep, dtype=float)  # pyright: ignore[reportCallIssue]
    x, residual = np.zeros_like(rhs), rhs
    # A right-hand side whose square overflows belongs to no system that could be solved.
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(rhs)
    if not np.isfinite(norm):
        return Krylov(x, 0, residual, False)
    target = rtol * norm
    while not norm <= target and iterations < MAX_ITERATIONS:
        cycle = min(RESTART, MAX_ITERATIONS - iterations)
        start = x if iterations else None
        new, _ = gcrotmk(A, rhs, start, rtol=rtol, atol=0.0, maxiter=1, M=P, m=cycle, k=0)
        left = rhs - times(new)
        before, after = norm, np.linalg.norm(left)
        if not after < before:
            break
        x, residual, norm = new, left, after
        if after > STALLED * before:
            break
    return Krylov(x, iterations, residual, bool(norm <= target))

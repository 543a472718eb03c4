"""One Newton solve on a frozen reference surface; the only place that calls a root finder."""

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from ..linalg import EXACT, SparseNewton, SparseSolver
from ._functional import EquilibriumSystem


class Solved(eqx.Module):
    """Unknowns, largest residual, Newton iterations and outcome."""

    unknowns: Float[Array, " unknowns"]
    residual: Float[Array, ""]
    iterations: Int[Array, ""]
    result: optx.RESULTS

    @property
    def converged(self) -> bool:
        """Whether Newton's method reached its tolerance."""
        return bool(self.result == optx.RESULTS.successful)


def _residual(v, system):
    return system.residual(v)


def newton(
    system: EquilibriumSystem,
    start: Float[Array, " unknowns"],
    tolerance: float | Float[Array, ""],
    max_steps: int,
    linear_solver: str,
    exact: float | Float[Array, ""] = EXACT,
) -> Solved:
    """Solve a system from a start; differentiable in the system by the implicit function theorem.

    `tolerance` is the largest error of the unknowns, `exact` the largest residual of constraints.
    The stiff saddle-point matrix is factorised as a whole, in nested-dissection order.
    """
    solver = SparseSolver(rtol=1e-11, method=linear_solver)
    # The factors are good to about 1e-11 only, which soft shapes enlarge: derivatives take another
    # iteration or two.
    finer = SparseSolver(rtol=1e-13, method=linear_solver)
    solution = optx.root_find(
        _residual,
        SparseNewton(tolerance, solver, exact=exact),
        start,
        system,
        max_steps=max_steps,
        adjoint=optx.ImplicitAdjoint(finer),
        throw=False,
    )
    v = solution.value
    worst = jnp.max(jnp.abs(system.residual(v)))
    return Solved(v, worst, jnp.asarray(solution.stats["num_steps"]), solution.result)


newton_jit = eqx.filter_jit(newton)

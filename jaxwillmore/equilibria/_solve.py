"""One Newton solve on a frozen reference surface; the only place that calls a root finder."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from ..linalg import EXACT, HostNewton, SparseNewton, SparseOperator, SparseSolver, solve_on_host
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


class OnHost:
    """A system as the host's Newton iteration sees it: NumPy outside, compiled functions inside.

    Nothing that is compiled calls back, so that JAX can keep it on disk.
    """

    groups = ()

    def __init__(self, system: EquilibriumSystem):
        self._system = system
        self.pattern = system.pattern
        self.n_fields, self.n_globals = system.n_fields, system.n_globals
        self.spans = slice(0, 1), slice(1, 4), *([slice(4, 5)] if system.has_phases else [])

    def residual(self, y):
        """F(y)."""
        return np.asarray(_residual_jit(jnp.asarray(y), self._system))

    def jacobian(self, y):
        """Blocks and border of the derivative."""
        return arrays_of(jacobian_of(self._system, jnp.asarray(y)))


_residual_jit = eqx.filter_jit(_residual)


@eqx.filter_jit
def jacobian_of(system: EquilibriumSystem, y: Float[Array, " unknowns"]) -> SparseOperator:
    """The derivative of the residual at `y`, compiled."""
    return system.jacobian(y)


def arrays_of(operator: SparseOperator):
    """Blocks and border of a matrix, for the host."""
    border = operator.border
    return np.asarray(operator.data), tuple(
        np.asarray(part) for part in (border.columns, border.rows, border.corner)
    )


def newton_on_host(
    system: EquilibriumSystem,
    start: Float[Array, " unknowns"],
    tolerance: float,
    max_steps: int,
    linear_solver: str,
    exact: float = EXACT,
) -> Solved:
    """As `newton`, without derivatives, and with nothing to compile but the system."""
    solver = HostNewton(tolerance, exact=exact, method=linear_solver)
    found = solve_on_host(solver, OnHost(system), np.asarray(start), max_steps=max_steps)
    if found.kept is not None:
        found.kept.release()
    worst = jnp.asarray(np.max(np.abs(found.f)))
    return Solved(jnp.asarray(found.y), worst, jnp.asarray(found.iterations), found.result)

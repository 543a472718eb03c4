"""Levenberg–Marquardt, one step at a time: every iterate can be seen, kept and resumed from."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ._results import RESULTS

# Rejected steps in a row after which no step is expected to help.
PATIENCE = 12
# Times that the damping is taken back where steps got short before the residuals were stationary:
# kinks in the distance raise it, and it would come down too late for a direction that hardly shows.
FRESH_STARTS = 4
# Part of the residuals that a linear change of the unknowns may still explain at a minimum, and
# where rounding or kinks in the distance let no step lower it further.
STATIONARY, NEARLY_STATIONARY = 1e-5, 1e-3
# Accepted steps that together bring less than a tenth of what the linear model promises for one,
# within a quarter of a standard error of its minimum: that lies in a kink, and they would go on
# along it for long.
CRAWL, INSIGNIFICANT = 5, 0.25


class Aux(eqx.Module):
    """What residuals say beside their values.

    **Attributes:**

    - `solved`: whether the model has a solution there.
    - `strain`: how far the model is from its frozen reference.
    - `numbers`: of the model, to be differentiated along with the residuals.
    - `model`: arrays of the model, to be had without solving it again.
    """

    solved: Bool[Array, ""]
    strain: Float[Array, ""]
    numbers: Float[Array, " numbers"] = eqx.field(default_factory=lambda: jnp.zeros(0))
    model: Any = ()


class Evaluated(NamedTuple):
    """Residuals, what they say beside, and derivatives of them and of `aux.numbers`."""

    residuals: Float[np.ndarray, " rows"]
    jacobian: Float[np.ndarray, "rows unknowns"]
    aux: Aux
    slopes: Float[np.ndarray, "numbers unknowns"]


class Iterate(NamedTuple):
    """An accepted step."""

    u: Float[Array, " unknowns"]
    objective: float
    strain: float


class Descent(NamedTuple):
    """Where a descent ended: unknowns, residuals and their derivative, and why.

    `result` is `None` where the strain ended it: the model wants a new reference. `solved` tells
    whether the model has a solution there with finite residuals; without one they say nothing.
    `aux` and `slopes` are as in `Evaluated`; `None` where no residuals were evaluated at all.
    """

    u: Float[Array, " unknowns"]
    residuals: Float[np.ndarray, " rows"]
    jacobian: Float[np.ndarray, "rows unknowns"]
    strain: float
    result: RESULTS | None
    steps: int
    solved: bool
    aux: Aux | None = None
    slopes: Float[np.ndarray, "numbers unknowns"] | None = None

    @property
    def objective(self) -> float:
        """Half the sum of squares."""
        return 0.5 * float(self.residuals @ self.residuals)


def explained(residuals: Float[np.ndarray, " rows"], jacobian: Float[np.ndarray, "rows n"]):
    """The part of the residuals that a linear change of the unknowns would remove, 0 to 1."""
    size = float(np.linalg.norm(residuals))
    if size == 0.0:
        return 0.0
    change = np.linalg.lstsq(jacobian, residuals, rcond=1e-8)[0]
    return float(np.linalg.norm(jacobian @ change)) / size


def descend(
    residuals: Callable[[Float[Array, " unknowns"]], tuple[Float[Array, " rows"], Aux]],
    u: Float[Array, " unknowns"],
    *,
    tolerance: float,
    max_steps: int,
    strain_limit: float = np.inf,
    observer: Callable[[Iterate], bool] | None = None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Descent:
    """Lower half the sum of squares of `residuals` from `u` by optimistix's Levenberg–Marquardt.

    **Arguments:**

    - `residuals`: a module; two with the same structure share the compiled step. Where there is no
      solution it must be large, so that the step is rejected.
    - `tolerance`: of unknowns and residuals, relative and absolute.
    - `strain_limit`: an iterate with more strain ends the descent.
    - `observer`: called with every accepted iterate, the first one included; says whether to stop.
    - `interrupted`: asked after every step whether to stop.
    """
    solver = _solver(tolerance)
    state = _init(solver, residuals, u)
    result, taken, accepted, starts = RESULTS.step_limit, 0, u, 0
    squares: list[float] = []
    for taken in range(max_steps + 1):
        accepted, state, _ = _step(solver, residuals, accepted, state)
        r = np.asarray(state.f_info.residual)
        if taken == 0 and not bool(state.aux[0].solved):
            result = RESULTS.interrupted if interrupted() else RESULTS.model_failed
            break
        if not np.all(np.isfinite(r)):
            result = RESULTS.not_finite
            break
        waited = int(state.num_steps_since_acceptance)
        seen = Iterate(accepted, 0.5 * float(r @ r), float(state.aux[0].strain))
        if observer is not None and waited == 0 and observer(seen):
            result = RESULTS.stopped
            break
        part = explained(r, np.asarray(_dense(state.f_info.jac))) if waited == 0 else np.inf
        if waited == 0:
            squares.append(float(r @ r))
        if part < STATIONARY or (waited == 0 and _crawls(squares, part, int(np.count_nonzero(r)))):
            result = RESULTS.converged
            break
        if interrupted():
            result = RESULTS.interrupted
            break
        if waited == 0 and float(state.aux[0].strain) > strain_limit:
            result = None
            break
        short = bool(state.terminate) or waited >= PATIENCE
        if short and waited == 0 and part >= NEARLY_STATIONARY and starts < FRESH_STARTS:
            state, starts = _init(solver, residuals, accepted), starts + 1
        elif bool(state.terminate):
            result = RESULTS.converged
            break
        elif short or not np.all(np.isfinite(np.asarray(state.y_eval))):
            result = RESULTS.stalled
            break
    end = _evaluated(state)
    r, J = end.residuals, end.jacobian
    if (
        result is not None
        and bool(result == RESULTS.stalled)
        and explained(r, J) < NEARLY_STATIONARY
    ):
        result = RESULTS.converged
    solved = bool(end.aux.solved) and bool(np.all(np.isfinite(r)))
    strain = float(end.aux.strain)
    return Descent(accepted, r, J, strain, result, taken, solved, end.aux, end.slopes)


def evaluate(residuals, u: Float[Array, " unknowns"]) -> Evaluated:
    """Residuals and derivatives at `u`, by the program of the steps of `descend`.

    Nothing is compiled for residuals of a structure that has descended before.
    """
    solver = _solver(1.0)
    return _evaluated(_step(solver, residuals, u, _init(solver, residuals, u))[1])


def _solver(tolerance: float) -> optx.LevenbergMarquardt:
    # Arrays, or every tolerance would compile the step again.
    return optx.LevenbergMarquardt(rtol=jnp.asarray(tolerance), atol=jnp.asarray(tolerance))  # pyright: ignore


def _evaluated(state) -> Evaluated:
    aux, slopes = state.aux
    J = np.asarray(_dense(state.f_info.jac))
    return Evaluated(np.asarray(state.f_info.residual), J, aux, np.asarray(slopes))


def _crawls(squares: list[float], part: float, rows: int) -> bool:
    """Whether steps near a minimum bring much less than the linear model says."""
    # One standard error explains a part 1/√rows of residuals that are noise.
    if part * np.sqrt(rows) >= INSIGNIFICANT or len(squares) <= CRAWL:
        return False
    return squares[-1 - CRAWL] - squares[-1] < 0.1 * part**2 * squares[-1]


def _call(u, residuals):
    """The residuals with their derivative as one dense matrix, found once for all its uses.

    Beside them what they say, and the derivatives of its numbers. The solver also asks for the
    product with the matrix of its empty first state; that must not lead into the linear solves of
    an implicit derivative.
    """

    def twice(u):
        r, aux = _at(residuals, u)
        return (r, aux.numbers), (r, aux)

    here = jax.lax.stop_gradient(u)
    (J, slopes), (r, aux) = jax.jacfwd(twice, has_aux=True)(here)
    return r + J @ (u - here), (aux, slopes)


# A program of its own, so that all uses below trace it once.
@eqx.filter_jit
def _at(residuals, u):
    return residuals(u)


# The state holds the traced derivative, which is compared by identity: the same compiled function
# must make it for all fits, or each of them would compile the step again.
@eqx.filter_jit
def _init(solver, residuals, u):
    f, aux = jax.eval_shape(lambda u: _at(residuals, u), u)
    slopes = jax.ShapeDtypeStruct((*aux.numbers.shape, *u.shape), u.dtype)
    return solver.init(_call, u, residuals, {}, f, (aux, slopes), frozenset())


@eqx.filter_jit
def _step(solver, residuals, u, state):
    return solver.step(_call, u, residuals, {}, state, frozenset())


@eqx.filter_jit
def _dense(operator):
    return operator.as_matrix()

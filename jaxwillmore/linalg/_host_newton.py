"""Newton's method on the host, outside any traced function, with a Jacobian that is kept."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
import optimistix as optx

from ._damping import damped, relative_size
from ._host import HOST
from ._host_matrix import FAILURES, HostMatrix
from ._mixing import Past, mixed
from ._newton import EXACT

# Least work of 1e-1 to 1e-6, for tolerances of 1e-5 and 1e-10 alike: a kept Jacobian contracts by
# 1e-1 or so whatever is asked of the linear solves, and mixing makes up for what they leave.
FORCING = 1e-2
# A slow Jacobian is kept as long as it should need no more iterations than these.
REMAINING = 3


@dataclasses.dataclass(frozen=True)
class _State:
    f: np.ndarray
    matrix: HostMatrix | None
    inherited: bool
    renew: bool = False
    # The last correction that was taken.
    d: np.ndarray | None = None
    size: float = math.inf
    contraction: float = math.inf
    damping: float = 1.0
    # Whether the last correction had a new Jacobian, and whether the last two had.
    new: bool = False
    both_new: bool = False
    past: Past = ()
    # The Schur complement while the global unknowns alone are corrected.
    schur: np.ndarray | None = None
    failure: int = 0
    iterations: int = 0
    jacobians: int = 0
    krylov_iterations: int = 0
    residuals: int = 0
    global_corrections: int = 0


class HostNewton(optx.AbstractRootFinder):
    r"""Simplified Newton iteration for a `HostSystem` passed as `args`; for `solve_on_host`.

    It has the interface of an Optimistix root finder, but its state is NumPy and its steps run on
    the host: nothing is traced, and nothing but the system needs compiling.

    A Jacobian is kept from iteration to iteration *and from solve to solve* while corrections
    contract by `keep`, or while it should need no more than three more of them. Corrections with
    one matrix are mixed (Anderson). Large ones are damped until the residual falls; where that does
    not help and the Jacobian is not new, they are thrown away and it is renewed.

    It has converged when the estimated error $\theta/(1-\theta)\,|d|$ is below `tolerance` in every
    field and global unknown, relative to its largest value (at least 1, its typical size), with
    $\theta$ the observed contraction (Hairer, Wanner (1996), *Solving ODEs II*, section IV.8).
    Global equations are constraints and hold to `exact`. When they alone are missing, the global
    unknowns are corrected along $W = PB$, what the preconditioner $P$ answers to them: no solve.

    **Arguments:**

    - `tolerance`: relative error of the unknowns.
    - `forcing`: relative residual of the linear solves.
    - `keep`: contraction up to which a Jacobian is kept.
    - `mixing`: past corrections that are mixed; 0 for none.
    - `exact`: largest residual of the global equations.
    - `method`: as of `SparseSolver`.

    **Raises** (as `HostSolution.result`): as `SparseNewton`.
    """

    rtol: float
    atol: float
    norm: Callable = eqx.field(static=True)
    forcing: float
    keep: float
    mixing: int
    exact: float
    method: str

    def __init__(
        self,
        tolerance: float,
        *,
        forcing: float = FORCING,
        keep: float = 0.3,
        mixing: int = 4,
        exact: float = EXACT,
        method: str = "krylov",
    ):
        self.rtol = self.atol = tolerance
        self.norm = optx.max_norm
        self.forcing, self.keep, self.mixing = forcing, keep, mixing
        self.exact, self.method = exact, method

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """`options` may hold `f`, the residual at `y`, and `kept`, a matrix to begin with."""
        del f_struct, aux_struct, tags
        f, kept, evaluated = options.get("f"), options.get("kept"), 0
        if f is None:
            (f, _), evaluated = fn(y, args), 1
        if kept is not None and not (kept.alive and kept.n_unknowns == len(y)):
            kept = None
        return _State(f, kept, inherited=kept is not None, residuals=evaluated)

    def step(self, fn, y, args, options, state, tags):
        """One correction of everything, or of the global unknowns alone."""
        if state.schur is not None:
            corrected = self._correct_globals(fn, y, args, state)
            if corrected is not None:
                return *corrected, None
        del options, tags
        new, matrix = state.renew, state.matrix
        if new or matrix is None:
            new, matrix = True, self._renewed(y, args, matrix)
        d, iterations, failure = matrix.solve(state.f, self.forcing)
        size = relative_size(args, y - d, d)
        state = dataclasses.replace(
            state,
            matrix=matrix,
            past=() if new else state.past,
            schur=None,
            failure=failure,
            renew=False,
            new=new,
            both_new=new and state.new,
            iterations=state.iterations + 1,
            jacobians=state.jacobians + new,
            krylov_iterations=state.krylov_iterations + iterations,
        )
        if failure:
            return y, _thrown_away(state, size), None
        mix = HOST.run(mixed, state.past, y, d) if state.past else None
        found = damped(lambda y: fn(y, args)[0], y, state.f, d, size, mix)
        state = dataclasses.replace(state, residuals=state.residuals + found.tried)
        if not found.accepted and not new:
            return y, _thrown_away(state, size), None
        contraction = math.inf
        if found.damping == 1.0 == state.damping and state.d is not None:
            # In one measure: the first corrections may make the unknowns grow a lot.
            before = relative_size(args, y - d, state.d)
            contraction = size / before if before > 0 else math.inf
        past = (*state.past, (y, d)) if self.mixing and found.damping == 1.0 else ()
        state = dataclasses.replace(
            state,
            f=found.f,
            d=d,
            size=size,
            contraction=contraction,
            damping=found.damping,
            renew=found.damping < 1.0 or self._is_slow(contraction, size),
            past=past[-self.mixing :],
        )
        if self._fields_converged(state) and args.n_globals:
            state = dataclasses.replace(state, schur=matrix.elimination().schur)
        return found.y, state, None

    def _renewed(self, y, args, old: HostMatrix | None) -> HostMatrix:
        """The Jacobian at `y`. The old one goes first, so that memory for one is enough."""
        if old is not None:
            old.release()
        data, border = args.jacobian(y)
        return HostMatrix(args.pattern, data, border, args.groups, self.method)

    def _is_slow(self, contraction: float, size: float) -> bool:
        if not math.isfinite(contraction) or contraction <= self.keep or size <= self.atol:
            return False
        if contraction >= 1.0:
            return True
        return math.log(self.atol / size) / math.log(contraction) > REMAINING

    def _correct_globals(self, fn, y, args, state):
        """A secant step of the global equations along W; nothing where that is not enough."""
        m, schur = args.n_globals, state.schur
        g = state.f[-m:]
        W = state.matrix.elimination().W
        tail = np.linalg.lstsq(schur, g, rcond=None)[0]
        correction = np.concatenate([-W @ tail, tail])
        # What W misses of A⁻¹B is a fraction of the correction and must stay within the tolerance.
        if not relative_size(args, y - correction, correction) <= self.atol:
            return None
        new_y = y - correction
        f, _ = fn(new_y, args)
        defect = f[-m:] - g + schur @ tail
        # Broyden's update: the Schur complement is that of P, and of the y of the Jacobian.
        schur = schur - np.outer(defect, tail) / max(tail @ tail, 1e-300)
        if not np.max(np.abs(f[-m:])) <= 0.5 * np.max(np.abs(g)):
            schur = None
        state = dataclasses.replace(
            state,
            f=f,
            schur=schur,
            residuals=state.residuals + 1,
            global_corrections=state.global_corrections + 1,
        )
        return new_y, state

    def _fields_converged(self, state) -> bool:
        theta = state.contraction
        error = theta / max(1 - theta, 1e-3) * state.size if theta < 1 else math.inf
        small = error <= self.atol or state.size <= 1e-2 * self.atol
        return small and state.damping == 1.0

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Any, optx.RESULTS]:
        """Whether to stop, and the result."""
        del fn, y, options, tags
        if state.failure and not state.renew:
            return True, optx.RESULTS.promote(FAILURES[state.failure])
        if not (state.iterations and np.all(np.isfinite(state.f))) or math.isnan(state.size):
            return state.iterations > 0, optx.RESULTS.nonfinite
        if self._fields_converged(state):
            exact = np.all(np.abs(state.f[len(state.f) - args.n_globals :]) <= self.exact)
            return bool(exact), optx.RESULTS.successful
        # A correction with an old Jacobian may be far too small: what follows it then grows.
        growing = 2.0 < state.contraction < math.inf and state.both_new
        if growing and state.size > self.atol:
            return True, optx.RESULTS.nonlinear_divergence
        return False, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """The counters, by the names of `HostSolution`."""
        del fn, args, options, tags, result
        return y, aux, {name: getattr(state, name) for name in COUNTERS}


COUNTERS = ("iterations", "jacobians", "krylov_iterations", "residuals", "global_corrections")


def _thrown_away(state: _State, size: float) -> _State:
    """After a correction that was not taken: once more with a new Jacobian, or a failure."""
    if state.new:
        return dataclasses.replace(state, size=size)
    return dataclasses.replace(
        state, renew=True, d=None, size=math.inf, contraction=math.inf, damping=1.0, past=()
    )

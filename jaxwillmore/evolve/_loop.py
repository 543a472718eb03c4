"""The loop of accepted and rejected steps."""

import math
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array

from .._observers import asks_to_stop
from ..mesh import SurfaceMesh, self_intersections
from ._adaptive import Controller
from ._checkpoints import Checkpoints, Pace
from ._continuation import Continuation, Origin
from ._host_step import HostStep
from ._record import diagnostics
from ._remeshing import NewMesh, Refused, Remeshing, moved
from ._save import Saver
from ._singular import NORMAL_LOST, explained, has_vanished
from ._solution import ENDS, RESULTS, Solution, State
from ._stepper import Attempt, History, Stepper, weights
from ._whole import check_fits

# Accepted rises of the energy may add up to this multiple of the tolerance for one step. A relaxed
# equilibrium is not the minimiser of a discrete energy and may settle slightly above the least one.
CREEP = 300.0
# The time of a contact is found to this part of the time that has passed.
CONTACT_TIME = 1e-3


# Compiled together with nothing else: each is a dozen operations.
_weights = eqx.filter_jit(weights)


_start = eqx.filter_jit(Stepper.start)


@eqx.filter_jit
def _push(history: History, t, attempt: Attempt) -> History:
    return history.push(t, attempt.x, attempt.U, attempt.amounts, attempt.multipliers)


class Loop:
    """Steps one run until it ends; all that changes in a run lives here.

    **Arguments:** see `evolve`. `advance_with` makes of a stepper what attempts a step,
    `(history, weights, t) -> Attempt`; `schedule` fixes the times and switches rejections off.
    """

    def __init__(
        self,
        stepper: Stepper,
        *,
        advance_with: Callable[[Stepper], Callable[..., Attempt]],
        controller: Controller,
        schedule: list[float] | None,
        order: int,
        stationary_tolerance: float | None,
        self_contact: bool,
        max_steps: int,
        saver: Saver,
        remeshing: Remeshing | None,
        observer: Callable[[dict[str, float | int], State], object] | None,
        on_save: Callable[[State], None] | None,
        checkpoints: Checkpoints | None,
        origin: Origin,
    ):
        self.advance_with, self.controller, self.remeshing = advance_with, controller, remeshing
        self._step_with(stepper)
        self.schedule, self.order = schedule, order
        self.stationary_tolerance, self.max_steps = stationary_tolerance, max_steps
        self.self_contact = self_contact
        self.saver, self.observer, self.on_save = saver, observer, on_save
        self.pace, self.origin = Pace(checkpoints), origin
        self.depth, self.rejections = max(order + 1, 3), 0
        self.started, self.earlier = time.perf_counter(), 0.0
        self.records: list[dict[str, float | int]] = []
        self.times: list[float] = []
        self.saved: list[State] = []
        self.new_meshes: list[NewMesh] = []
        self.stats: dict[str, Any] = {
            "steps": 0,
            "rejected_steps": 0,
            "newton_iterations": 0,
            "jacobians": 0,
            "linear_iterations": 0,
        }
        if remeshing is not None:
            self.stats |= {"remeshings": 0, "refused_remeshings": 0, "refused_because": ""}

    def _step_with(self, stepper: Stepper) -> None:
        self.stepper, self.advance = stepper, self.advance_with(stepper)

    @property
    def _mesh(self) -> SurfaceMesh:
        return self.stepper.problem.mesh

    def run(
        self, x0: Array, fields: dict[str, Array], t0: float, t1: float, dt: float, interrupted
    ) -> Solution:
        """From `t0` to `t1`, starting with a step `dt`."""
        self.dt = dt
        self.history = _start(self.stepper, jnp.asarray(t0), x0, fields, self.depth)
        self.state = State(t0, x0, self._initial_fields(self.history), self._mesh)
        self.times.append(t0)
        # Of these only the energy is read, which needs no field that a step would have to find.
        nothing = jnp.zeros(self.stepper.problem.flow.n_globals)
        first = self._diagnostics(x0, self.stepper.fields(self.history.U[0]), nothing)
        self.energy, self.size = float(first["energy"]), float(first["energy_scale"])
        self.floor, self.least = 0.1 * self.size, self.energy
        self._save([self.state])
        self.pace.now(self._so_far)
        return self._steps(t1, interrupted)

    def resume(self, solution: Solution, t1: float, interrupted) -> Solution:
        """From where another loop ended, or was when it handed out its solution."""
        c = solution.continuation
        if solution.new_meshes:
            self._step_with(self.stepper.on(solution.mesh))
        self.new_meshes = list(solution.new_meshes)
        check_fits(c, self.stepper.problem.flow, self.depth)
        self.history, self.state = c.history, solution.state
        self.dt, self.rejections = c.dt, c.rejections
        self.energy, self.size, self.floor, self.least = c.energy, c.size, c.floor, c.least
        self.records, self.times = list(solution.records), list(solution.times)
        self.saved, self.stats = list(solution.saved), dict(solution.stats)
        self.earlier = self.stats.get("wall_seconds", 0.0)
        self.saver.skip(solution.state.t)
        if any(bool(solution.result == end) for end in ENDS):
            return self._solution(solution.result)
        if isinstance(self.advance, HostStep):
            self.advance.keep(c.kept)
        return self._steps(t1, interrupted)

    def _steps(self, t1: float, interrupted) -> Solution:
        result = None
        while result is None:
            result = self._limits(self.state.t, t1, interrupted())
            if result is None:
                result = self._attempt(t1)
        result, singular = explained(result, self.stepper.problem.flow, self.times[0], self.records)
        if bool(result == RESULTS.contact):
            singular = self.state.t + self.dt
        if singular is not None:
            self.stats["singular_time"] = singular
        return self._solution(result)

    def _attempt(self, t1: float) -> RESULTS | None:
        """One attempt at a step, kept or not; why the run ends with it, if it does."""
        dt, t = self._target(self.state.t, t1, self.dt)
        known = min(len(self.times), self.depth)
        w = _weights(self.history.times, jnp.asarray(t), known, self.order)
        attempt = self.advance(self.history, w, jnp.asarray(t))
        record = self._record(attempt, t)
        reason, factor = self._judge(attempt, record, self.energy)
        self._count(attempt)
        if reason is None and self._touches(attempt):
            reason, factor = RESULTS.contact, 0.5
        if reason is not None:
            self.rejections += 1
            self.stats["rejected_steps"] += 1
            self.dt = dt * factor
            located = CONTACT_TIME * (t - self.times[0]) if reason == RESULTS.contact else 0.0
            if self.schedule is not None or self.dt < max(self.controller.smallest, located):
                return reason
            return None
        self.history = _push(self.history, jnp.asarray(t), attempt)
        self.times.append(t)
        reference = self._reference()
        # An energy without terms, of a surface in one pure phase for instance, has no size.
        rise = (record["energy"] - self.energy) / reference if reference else 0.0
        self.energy, self.size = record["energy"], record["energy_scale"]
        self.least = min(self.least, self.energy)
        self.state = State(t, attempt.x, self.stepper.fields(attempt.U), self._mesh)
        stopped = self._accept(record, attempt, self.state, dt, self.rejections)
        self._save(self.saver.passed(self.stepper, self.history, len(self.times)))
        self.rejections = 0
        self.dt = self.controller.after_acceptance(
            dt, float(attempt.error), self.order, int(attempt.newton_iterations), rise
        )
        if stopped:
            return RESULTS.stopped
        if has_vanished(self.records):
            return RESULTS.vanished
        if self._is_stationary(record):
            return RESULTS.stationary
        if self._is_time_for_a_new_mesh(t1):
            self._remesh()
        self.pace.step(self._so_far)
        return None

    def _so_far(self) -> Solution:
        return self._solution(RESULTS.interrupted)

    def _solution(self, result: RESULTS) -> Solution:
        wall = self.earlier + time.perf_counter() - self.started
        return Solution(
            tuple(self.saved),
            self.state,
            tuple(self.times),
            tuple(self.records),
            result,
            self.stats | {"wall_seconds": wall},
            Continuation(
                self.origin,
                self.history,
                self.dt,
                self.energy,
                self.size,
                self.floor,
                self.least,
                self.rejections,
                self.advance.kept if isinstance(self.advance, HostStep) else None,
            ),
            tuple(self.new_meshes),
        )

    def _is_time_for_a_new_mesh(self, t1: float) -> bool:
        if self.remeshing is None or self.state.t >= t1:
            return False
        is_looked_at = self.stats["steps"] % self.remeshing.every == 0
        return is_looked_at and self.remeshing.is_due(self._mesh, self.state.x)

    def _remesh(self) -> None:
        """Go on with a new mesh, unless none is any good."""
        assert self.remeshing is not None
        step = self.stats["steps"]
        found = moved(
            self.remeshing, self.stepper, self.history, step, self.energy, self._reference()
        )
        if isinstance(found, Refused):
            self.stats["refused_remeshings"] += 1
            self.stats["refused_because"] = found.reason
            return
        self.stats["remeshings"] += 1
        self.new_meshes.append(found.new)
        self._step_with(found.stepper)
        self.history = found.history
        # The rise by a new mesh is no rise of the flow.
        self.least += found.energy - self.energy
        self.energy, self.size = found.energy, found.size
        fields = self.stepper.fields(self.history.U[0])
        self.state = State(self.state.t, self.history.x[0], fields, self._mesh)

    def _initial_fields(self, history: History) -> dict[str, Array]:
        flow = self.stepper.problem.flow
        fields = self.stepper.fields(history.U[0])
        return {name: value for name, value in fields.items() if name in flow.evolving}

    def _limits(self, t: float, t1: float, interrupted: bool):
        if t >= t1 or (self.schedule is not None and self.stats["steps"] + 1 == len(self.schedule)):
            return RESULTS.reached_t1
        if interrupted:
            return RESULTS.interrupted
        if self.stats["steps"] >= self.max_steps:
            return RESULTS.step_limit
        return None

    def _target(self, t: float, t1: float, dt: float) -> tuple[float, float]:
        if self.schedule is not None:
            t_new = self.schedule[self.stats["steps"] + 1]
            return t_new - t, t_new
        left = t1 - t
        if dt >= left:
            return left, t1
        # Two equal steps at the end rather than a full one and a sliver.
        dt = min(dt, 0.5 * left)
        return dt, t + dt

    def _diagnostics(self, x, fields, multipliers) -> dict[str, Array | float]:
        p = self.stepper.problem
        return diagnostics(p.flow, p.mesh, x, fields, multipliers)

    def _record(self, attempt: Attempt, t: float) -> dict[str, float | int]:
        fields = self.stepper.fields(attempt.U)
        values = self._diagnostics(attempt.x, fields, attempt.multipliers)
        return {"t": t} | {name: float(value) for name, value in values.items()}

    def _judge(self, attempt: Attempt, record: dict[str, float | int], energy: float):
        """Why the step is rejected, with the factor for the next try; (None, 1) accepts."""
        if not math.isfinite(record["energy"]) or not math.isfinite(float(attempt.error)):
            return RESULTS.not_finite, 0.25
        if bool(attempt.result != optx.RESULTS.successful):
            return RESULTS.step_too_small, 0.25
        if record.get("alignment", 1.0) <= 0:
            return RESULTS.element_inverted, 0.5
        if record.get("normal_length_defect", 0.0) > NORMAL_LOST:
            return RESULTS.resolution_lost, 0.5
        rise = self.controller.energy_tolerance * self._reference()
        if record["energy"] > energy + rise or record["energy"] > self.least + CREEP * rise:
            return RESULTS.energy_rising, 0.5
        if self.schedule is None and float(attempt.error) > self.controller.rtol:
            return RESULTS.step_too_small, 0.5
        return None, 1.0

    def _touches(self, attempt: Attempt) -> bool:
        return self.self_contact and self_intersections(self.stepper.problem.mesh, attempt.x) > 0

    def _reference(self) -> float:
        r"""What a change of the energy is relative to: $\max(S, S_0/10)$, $S = \sum_i |E_i|$.

        Relative to $|E|$ the guard would depend on a constant in the energy, and reject what the
        discretisation does to every step where the terms $E_i$ cancel.
        """
        return max(self.size, self.floor)

    def _count(self, attempt: Attempt) -> None:
        for name in ("newton_iterations", "jacobians", "linear_iterations"):
            self.stats[name] += int(getattr(attempt, name))

    def _accept(self, record, attempt: Attempt, state: State, dt: float, rejections: int) -> bool:
        """Count and record a step; whether the observer asks to stop."""
        self.stats["steps"] += 1
        names = self.stepper.problem.flow.global_names
        record |= {name: float(attempt.multipliers[k]) for k, name in enumerate(names)}
        counts = {
            "newton_iterations": int(attempt.newton_iterations),
            "krylov_iterations": int(attempt.linear_iterations),
            "rejected_steps": rejections,
        }
        record = {"step": self.stats["steps"], "dt": dt, "error": float(attempt.error)} | record
        self.records.append(record | counts)
        return self.observer is not None and asks_to_stop(self.observer(record | counts, state))

    def _save(self, states: list[State]) -> None:
        for state in states:
            self.saved.append(state)
            if self.on_save is not None:
                self.on_save(state)

    def _is_stationary(self, record: dict[str, float | int]) -> bool:
        tolerance = self.stationary_tolerance
        return tolerance is not None and record["stationarity"] <= tolerance

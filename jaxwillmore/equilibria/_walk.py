"""The loop of `branch`: step after step, and what lies between."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from .._interrupts import interrupted
from .._observers import asks_to_stop
from ..mesh import self_intersections
from ._diagnostics import mesh_health
from ._events import BranchEvent, Step, event_at, events_of
from ._family import Branch, Continuation
from ._follow import Follower
from ._relax import LARGEST_STEP
from ._results import BRANCH_RESULTS, RESULTS
from ._shape import Equilibrium, finished

# Most of them are with a Jacobian that is kept, and cost little.
FEW_ITERATIONS, MANY_ITERATIONS = 9, 12
# The displacement that a step aims at, in units of the size of the surface.
AIM = 0.06
# Length of a step over its projection on the tangent: 1/cos 30°.
LARGEST_BEND = 1.155


class Walk:
    """A branch while it is followed: where it stands, and what it has collected."""

    def __init__(
        self,
        follower: Follower,
        settings: dict[str, Any],
        observer: Callable[[dict[str, Any], Equilibrium], object] | None,
        checkpoints: Callable[[Branch], object] | None,
    ):
        self.follower, self.settings = follower, settings
        self.parameter: str = settings["parameter"]
        self.observer, self.checkpoints = observer, checkpoints
        self.points: list[Equilibrium] = []
        self.rows: list[dict[str, Any]] = []
        self.events: list[BranchEvent] = []
        self.stopped = False
        self.length, self.accepted = 0.0, 0
        # Points and events before the step in progress, and points that the observer has seen.
        self.sure, self.seen = (0, 0), 0

    def begin(self, start: Equilibrium, stop: float, step0: float, least: float) -> None:
        """Stand at the start, and look towards the stop.

        - `step0`, `least`: first and smallest step of the scaled parameter.
        """
        f, self.regular = self.follower, start
        if stop == f.value:
            return self._add(start, f.value, 0, 0.0)
        f.head(stop)
        self.length = max(f.first_length(step0, AIM), least)
        self._arrive(start, f.value, 0, 0.0)

    def go_on(self, before: Branch, here: Continuation) -> None:
        """Stand where another walk stood."""
        self.follower.point, self.length, self.accepted = here.at, here.length, here.accepted
        self.sure, self.seen = (here.n_points, here.n_events), len(before.points)
        self.points = list(before.points[: here.n_points])
        self.rows = list(before.rows[: here.n_points])
        self.events = list(before.events[: here.n_events])
        pairs = zip(self.points, self.rows, strict=True)
        self.regular = [point for point, row in pairs if row["event"] is None][-1]

    def so_far(self, result: BRANCH_RESULTS) -> Branch:
        """The branch as it is."""
        here = None
        if self.length > 0:
            settings = tuple(self.settings.items())
            at = self.follower.point
            here = Continuation(settings, at, self.length, self.accepted, *self.sure)
        collected = tuple(self.points), tuple(self.rows), tuple(self.events)
        return Branch(self.parameter, *collected, result, here)

    def follow(self, stop: float, least: float, largest: float, max_points: int) -> BRANCH_RESULTS:
        """Walk on until the stop, or another end.

        - `least`, `largest`: lengths of a step.
        """
        f = self.follower
        if self.stopped:
            return BRANCH_RESULTS.stopped
        if stop == f.value:
            return BRANCH_RESULTS.end_reached
        side, stop = np.sign(stop - f.value), stop / f.scale
        while self.accepted < max_points:
            if interrupted():
                return BRANCH_RESULTS.interrupted
            here, length = f.point, self.length
            ahead = here.p + length * float(here.tangent_g[-1])
            # Nearer to the end than the smallest step is at the end.
            last = bool(side * (ahead - stop) >= -least)
            at = self._to(stop) if last else self._along(length)
            system, solved = at(1.0)
            good = self._is_good(system, solved)
            if good and not last and side * (float(solved.unknowns[-1]) - stop) > 0:
                # The curve bent towards the end: take the rest in one step of known size.
                last, at = True, self._to(stop)
                system, solved = at(1.0)
                good = solved.converged
            through = system, solved
            if good and last:
                final = f.settled(system, solved)
                good = final is not None
                system, solved = final if final is not None else (system, solved)
            if not good:
                self.length = length / 2
                if self.length < least:
                    return BRANCH_RESULTS.step_too_small
                continue
            end = self._end(at, through, (system, solved), last)
            if not isinstance(end, Equilibrium):
                return end
            value, iterations = float(solved.unknowns[-1]) * f.scale, int(solved.iterations)
            if last:
                self._add(end, value, iterations, length * f.scale)
                return BRANCH_RESULTS.stopped if self.stopped else BRANCH_RESULTS.end_reached
            displaced = float(system.assessed(solved.unknowns).step)
            f.accept(system, solved)
            self.accepted += 1
            self.length = _next_length(length, iterations, displaced, largest)
            self._arrive(end, value, iterations, length * f.scale)
            if self.stopped:
                return BRANCH_RESULTS.stopped
        return BRANCH_RESULTS.point_limit

    def _along(self, length: float):
        return lambda t: self.follower.along(t * length)

    def _to(self, stop: float):
        start = self.follower.point.p
        return lambda t: self.follower.to(start + t * (stop - start))

    def _is_good(self, system, solved) -> bool:
        """Whether a step converged, is small, and follows the tangent."""
        if not solved.converged:
            return False
        small = float(system.assessed(solved.unknowns).step) < LARGEST_STEP
        return small and self.follower.bend(system, solved) < LARGEST_BEND

    def _end(self, at, through, end, last: bool) -> Equilibrium | BRANCH_RESULTS:
        """The shape at the end of a step, what lies before it being kept; or why to stop there."""
        system, solved = end
        r, f = system.reference, self.follower
        x = r.positions(system.unpack(solved.unknowns)[0])
        if not mesh_health(r.mesh, x).is_sound:
            return BRANCH_RESULTS.resolution_lost
        if self.settings["self_contact"] and self_intersections(r.mesh, x):
            return BRANCH_RESULTS.self_contact
        stats = {"newton_iterations": int(solved.iterations)}
        point = finished(
            system,
            solved,
            RESULTS.converged,
            f.units,
            self.settings["stability"],
            f.relaxation.linear_solver,
            stats,
        )
        # At the end the parameter is prescribed: nothing turns on the way there.
        ahead = float(f.point.tangent_g[-1])
        turned = not last and ahead * float(f.tangent(through[0], through[1].unknowns)[-1]) < 0
        value = float(solved.unknowns[-1]) * f.scale
        turn = float(np.sign(ahead)) if turned else 0.0
        self._between(Step(at, f.linear_solver), point, value, turn)
        return BRANCH_RESULTS.stopped if self.stopped else point

    def _between(self, step: Step, point: Equilibrium, value: float, turn: float) -> None:
        """Find the folds and bifurcations before the next point and keep each as a point.

        - `value`: the parameter at the next point.
        - `turn`: as of `events_of`.
        """
        f, before = self.follower, self.regular
        negative = before.negative_directions, point.negative_directions
        known = None if None in negative else negative
        try:
            for t, is_fold in events_of(step, before, point, turn):
                event = event_at(step, t, is_fold, self.parameter, f.scale, f.units, known)
                event = dataclasses.replace(event, point=len(self.points))
                self.events.append(event)
                iterations = int(step.found(t).solved.iterations)
                self._add(event.shape, event.value, iterations, 0.0, event.event)
                if self.stopped:
                    return
        except ArithmeticError:
            here, there = (f"{float(v):.5g}" for v in (self.rows[-1][self.parameter], value))
            warnings.warn(
                f"Between {self.parameter} = {here} and {there} the branch turns or another one "
                f"crosses it (negative directions {negative[0]} and {negative[1]}), but no "
                "solution was found in between: the point is not among the events. A smaller "
                "`max_step` may find it.",
                RuntimeWarning,
                stacklevel=5,
            )

    def _arrive(self, point: Equilibrium, value: float, iterations: int, step: float) -> None:
        """Keep the end of a step, where the follower stands already, and hand out the branch."""
        self.regular, self.sure = point, (len(self.points) + 1, len(self.events))
        self._add(point, value, iterations, step)
        if self.checkpoints is not None and not self.stopped:
            self.checkpoints(self.so_far(BRANCH_RESULTS.interrupted))

    def _add(
        self,
        point: Equilibrium,
        value: float,
        iterations: int,
        step: float,
        event: str | None = None,
    ) -> None:
        row = _row(point, self.parameter, value, iterations, step) | {"event": event}
        self.points.append(point)
        self.rows.append(row)
        if self.observer is not None and len(self.points) > self.seen:
            self.stopped = asks_to_stop(self.observer(row, point))


def _next_length(length: float, iterations: int, displaced: float, largest: float) -> float:
    factor = 1.5 if iterations <= FEW_ITERATIONS else 1.0
    factor = 0.6 if iterations >= MANY_ITERATIONS else factor
    return min(length * min(factor, AIM / max(displaced, 1e-12)), largest)


def _row(point: Equilibrium, parameter: str, value: float, iterations: int, step: float):
    health = point.health
    negative = point.negative_directions
    row = {
        "reduced_volume": float(point.reduced_volume),
        "bending_over_8pi_kappa": float(point.bending_over_8pi_kappa),
        "energy": float(point.energy),
        "tension": float(point.tension),
        "pressure": float(point.pressure),
        "scaled_tension": float(point.scaled_tension),
        "scaled_pressure": float(point.scaled_pressure),
        "negative_directions": float("nan") if negative is None else float(negative),
        "lowest_eigenvalue": point.eigenvalues[0] if point.eigenvalues else float("nan"),
        "energy_error": point.energy_error,
        "min_angle": health.min_angle,
        "mid_node_offset": health.mid_node_offset,
        "min_jacobian": health.min_jacobian,
        "newton_iterations": float(iterations),
        "step": step,
    }
    if point.chemical_potential is not None and point.mean_concentration is not None:
        row["total_energy"] = float(point.total_energy)
        row["mixing_energy"] = float(point.mixing_energy)
        row["chemical_potential"] = float(point.chemical_potential)
        row["mean"] = float(point.mean_concentration)
    return {parameter: value} | row

"""branch: a family of equilibria followed along a parameter, around folds."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from .._interrupts import interrupted
from .._observers import asks_to_stop
from ..mesh import check_surface
from ..phases import checked_width
from ._diagnostics import mesh_health
from ._equilibrium import LARGEST_STEP
from ._events import BranchEvent, Step, event_at, events_of
from ._follow import Follower
from ._results import BRANCH_RESULTS, RESULTS, message, name_of
from ._shape import Equilibrium, finished
from ._targets import SPHERE, checked_known, only_sphere

# Most of them are with a Jacobian that is kept, and cost little.
FEW_ITERATIONS, MANY_ITERATIONS = 9, 12
# The displacement that a step aims at, in units of the size of the surface.
AIM = 0.06
# Length of a step over its projection on the tangent: 1/cos 30°.
LARGEST_BEND = 1.155


@dataclasses.dataclass(frozen=True)
class Branch:
    """A family of equilibria in the order it was followed."""

    parameter: str
    """Name of the parameter followed."""
    points: tuple[Equilibrium, ...]
    """The shapes, the start first."""
    rows: tuple[dict[str, Any], ...]
    """One dictionary of numbers per point, and the word `event`: `"fold"`, `"bifurcation"` or
    `None`."""
    events: tuple[BranchEvent, ...]
    """Folds and bifurcations, each of them a point of its own."""
    result: BRANCH_RESULTS
    """Why it ended."""

    @property
    def succeeded(self) -> bool:
        """Whether it reached its end."""
        return bool(self.result == BRANCH_RESULTS.end_reached)

    def table(self) -> str:
        """The rows as comma-separated values with a header."""
        names = list(self.rows[0])
        lines = [",".join(names)]
        lines += [",".join(_word(row[name]) for name in names) for row in self.rows]
        return "\n".join(lines) + "\n"


def branch(
    equilibrium: Equilibrium,
    parameter: str = "reduced_volume",
    *,
    stop: float,
    step0: float | None = None,
    max_step: float | None = None,
    min_step: float | None = None,
    max_points: int = 100,
    self_contact: bool = False,
    stability: bool = True,
    tolerance: float = 1e-10,
    linear_solver: str = "direct",
    throw: bool = False,
    observer: Callable[[dict[str, Any], Equilibrium], bool | None] | None = None,
) -> Branch:
    r"""Follow a family of equilibria from one of them until a parameter reaches `stop`.

    Secant predictor, Newton corrector with a pseudo-arclength equation in the plane of normal
    displacement and parameter, so that folds are passed; after every point the reference surface
    moves to the shape with the least deformation. A step that bends by more than 30° from the one
    before is halved, so that the branch does not jump to another one nearby. The last point has the
    parameter `stop` exactly.

    Where a constrained eigenvalue changes its sign, or the branch turns, the place is found to 1e-5
    of the scaled parameter and becomes a point of its own: a fold, a pitchfork or a transcritical
    point (`BranchEvent`), from which `switch` starts the branch that crosses. Where it cannot be
    found a `RuntimeWarning` says so.

    **Arguments:**

    - `equilibrium`: the start; its held and free quantities stay as they are.
    - `parameter`: `"reduced_volume"` (area and volume held), `"spontaneous_curvature"` (of one
      phase) or `"pressure"` (volume free); of two phases also `"mean"`, the amount over the area
      (held), `"line_tension"` or `"interface_width"`.
    - `stop`: the end, in the units of the parameter; the branch starts towards it.
    - `step0`, `max_step`, `min_step`: changes of the parameter in the first, largest and smallest
      step. After the first step they bound the arclength that a parameter step of that size has.
    - `max_points`: most points after the start.
    - `self_contact`: also stop where triangles of the surface pierce each other.
    - `stability`: count the negative directions of every point.
    - `throw`: raise `RuntimeError` unless `stop` is reached. By default all converged shapes are
      returned with the reason.
    - `observer`: called with the row and the shape of every point as soon as it is found; `True`
      ends the branch, as in `evolve`.

    **Raises:** `ValueError` for a parameter that the start does not allow, or an impossible `stop`.

    *Limits:* with `stability=False`, or a start that has no eigenvalues, bifurcations are passed
    without a word. A mesh whose symmetry does not hold that of the branch is an imperfection: there
    a pitchfork dissolves into a fold and a smooth bend, which may lead away; meshes of
    `mesh.from_sphere_map` are five-fold about z, and keep bodies of revolution about z on theirs.
    """
    checked_known("branch", equilibrium=equilibrium, stop=stop)
    _check_stop(equilibrium, parameter, stop)
    follower = Follower(equilibrium, parameter, tolerance, linear_solver)
    size = follower.scale
    step0 = 0.04 * size if step0 is None else abs(step0)
    limits = (
        (1e-4 * size if min_step is None else min_step) / size,
        (0.5 * size if max_step is None else max_step) / size,
    )
    run = _Run(follower, equilibrium, parameter, stability, self_contact, observer)
    result = run.follow(stop, step0 / size, limits, max_points)
    done = Branch(parameter, tuple(run.points), tuple(run.rows), tuple(run.events), result)
    if throw and not (done.succeeded or bool(result == BRANCH_RESULTS.stopped)):
        last = run.rows[-1][parameter]
        raise RuntimeError(
            f"The branch ended at {parameter} = {last:.6g} of {stop:.6g} "
            f"({name_of(result)}): {message(result)}"
        )
    return done


def _check_stop(equilibrium: Equilibrium, parameter: str, stop: float) -> None:
    if not equilibrium.succeeded:
        raise ValueError("A branch starts from an equilibrium that converged.")
    if not np.isfinite(stop):
        raise ValueError(f"`stop` must be finite; got {stop!r}.")
    if parameter == "reduced_volume" and not 0 < stop <= 1:
        raise ValueError(f"A reduced volume lies in (0, 1); got `stop` = {stop:.6g}.")
    if parameter == "reduced_volume" and stop > SPHERE:
        raise ValueError(f"`stop` {only_sphere(stop)}")
    if parameter == "mean" and not 0 < stop < 1:
        raise ValueError(f"A mean concentration lies in (0, 1); got `stop` = {stop:.6g}.")
    if parameter in ("line_tension", "interface_width") and not stop > 0:
        raise ValueError(f"`{parameter}` is positive; got `stop` = {stop:.6g}.")
    if parameter == "interface_width":
        checked_width(equilibrium.mesh, equilibrium.x, stop)


class _Run:
    """The loop over points and what it has collected."""

    def __init__(self, follower, start, parameter, stability, self_contact, observer):
        self.follower, self.parameter, self.observer = follower, parameter, observer
        self.stability, self.self_contact = stability, self_contact
        self.points: list[Equilibrium] = []
        self.rows: list[dict[str, Any]] = []
        self.events: list[BranchEvent] = []
        self.stopped = False
        self.regular = start
        self._add(start, follower.value, 0, 0.0)

    def follow(self, stop: float, step0: float, limits, max_points: int) -> BRANCH_RESULTS:
        f, accepted = self.follower, 0
        if self.stopped:
            return BRANCH_RESULTS.stopped
        if stop == f.value:
            return BRANCH_RESULTS.end_reached
        f.head(stop)
        side, stop = np.sign(stop - f.value), stop / f.scale
        length = max(f.first_length(step0, AIM), limits[0])
        while accepted < max_points:
            if interrupted():
                return BRANCH_RESULTS.interrupted
            here = f.point
            ahead = here.p + length * float(here.tangent_g[-1])
            # Nearer to the end than the smallest step is at the end.
            last = bool(side * (ahead - stop) >= -limits[0])
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
                length = length / 2
                if length < limits[0]:
                    return BRANCH_RESULTS.step_too_small
                continue
            trouble = self._record(at, through, (system, solved), length, last)
            if trouble is not None or last:
                return BRANCH_RESULTS.end_reached if trouble is None else trouble
            accepted += 1
            displaced = float(system.assessed(solved.unknowns).step)
            f.accept(system, solved)
            length = _next_length(length, int(solved.iterations), displaced, limits[1])
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

    def _record(self, at, through, end, length: float, last: bool) -> BRANCH_RESULTS | None:
        """Keep what lies on a step and its end, unless the mesh is no evidence; why to stop."""
        system, solved = end
        r, f = system.reference, self.follower
        x = r.positions(system.unpack(solved.unknowns)[0])
        if not mesh_health(r.mesh, x).is_sound:
            return BRANCH_RESULTS.resolution_lost
        if self.self_contact and _pierces(r.mesh, x):
            return BRANCH_RESULTS.self_contact
        iterations = int(solved.iterations)
        stats = {"newton_iterations": iterations}
        point = finished(
            system,
            solved,
            RESULTS.converged,
            f.units,
            self.stability,
            f.relaxation.linear_solver,
            stats,
        )
        # At the end the parameter is prescribed: nothing turns on the way there.
        ahead = float(f.point.tangent_g[-1])
        turned = not last and ahead * float(f.tangent(through[0], through[1].unknowns)[-1]) < 0
        value = float(solved.unknowns[-1]) * f.scale
        turn = float(np.sign(ahead)) if turned else 0.0
        self._between(Step(at, f.linear_solver), point, value, turn)
        if self.stopped:
            return BRANCH_RESULTS.stopped
        self.regular = point
        self._add(point, value, iterations, length * f.scale)
        return BRANCH_RESULTS.stopped if self.stopped else None

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

    def _add(
        self, point, value: float, iterations: int, step: float, event: str | None = None
    ) -> None:
        row = _row(point, self.parameter, value, iterations, step) | {"event": event}
        self.points.append(point)
        self.rows.append(row)
        if self.observer is not None:
            self.stopped = asks_to_stop(self.observer(row, point))


def _word(value) -> str:
    return (value or "") if value is None or isinstance(value, str) else f"{value:.12g}"


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


def _pierces(mesh, x) -> bool:
    """Whether flat triangles between the vertices pierce each other."""
    triangles = np.asarray(mesh.triangles)
    vertices = np.asarray(x)[: triangles.max() + 1]
    report = check_surface(vertices, triangles)
    return any(finding.kind == "self_intersections" for finding in report.findings)

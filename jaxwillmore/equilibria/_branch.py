"""branch: a family of equilibria followed along a parameter, around folds."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._interrupts import interrupted
from .._observers import asks_to_stop
from ..mesh import check_surface
from ..phases import checked_width
from ._diagnostics import mesh_health
from ._equilibrium import LARGEST_STEP, Relaxation, settle
from ._functional import EquilibriumSystem, Path, Reference, concentration
from ._line import line
from ._parameters import Units
from ._reference import advanced
from ._results import BRANCH_RESULTS, RESULTS, message, name_of
from ._shape import Equilibrium, finished
from ._solve import Solved
from ._targets import SPHERE, checked_known, only_sphere

# Most of them are with a Jacobian that is kept, and cost little.
FEW_ITERATIONS, MANY_ITERATIONS = 9, 12
# The displacement that a step aims at, in units of the size of the surface.
AIM = 0.06


@dataclasses.dataclass(frozen=True)
class Branch:
    """A family of equilibria in the order it was followed."""

    parameter: str
    """Name of the parameter followed."""
    points: tuple[Equilibrium, ...]
    """The shapes, the start first."""
    rows: tuple[dict[str, float], ...]
    """One dictionary of numbers per point."""
    events: tuple[tuple[int, str], ...]
    """Point number and what happened there: folds and changes of stability."""
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
        lines += [",".join(f"{row[name]:.12g}" for name in names) for row in self.rows]
        return "\n".join(lines) + "\n"


class _Point(eqx.Module):
    """Where the branch is: a reference surface at its shape, unknowns, and the tangent there."""

    reference: Reference
    y: Float[Array, "nodes fields"]
    g: Float[Array, " globals"]
    tangent_s: Float[Array, " nodes"]
    tangent_y: Float[Array, "nodes fields"]
    tangent_g: Float[Array, " globals"]

    @property
    def p(self) -> float:
        """Scaled parameter."""
        return float(self.g[-1])


class _Follower:
    """Predictor and corrector of one branch, in dimensionless unknowns."""

    def __init__(self, start: Equilibrium, parameter: str, tolerance: float, linear_solver: str):
        flags = start.fixed_area, start.fixed_volume
        self.units: Units = start.units
        self.relaxation = Relaxation(start.mesh, flags, tolerance, linear_solver)
        self.base, self.direction, self.scale, value = line(start, parameter)
        y, g = start.nodal_unknowns
        r = self.relaxation.reference(self.units.inward(start.x), start.c)
        g = g.at[-1].set(value / self.scale)
        zero = jnp.zeros_like
        self.point = _Point(r, y, g, zero(y[:, 0]), zero(y), zero(g))
        self.value = value

    def head(self, stop: float) -> None:
        """The first tangent: the parameter alone, towards `stop`."""
        sign = jnp.sign(stop - self.value)
        self.point = eqx.tree_at(
            lambda p: p.tangent_g, self.point, self.point.tangent_g.at[-1].set(sign)
        )

    def _system(self, r: Reference, path: Path) -> EquilibriumSystem:
        system = self.relaxation.system(r, self.base)
        return eqx.tree_at(lambda s: s.path, system, path)

    def along(self, length: float):
        """Correct the secant prediction at pseudo-arclength `length`."""
        here = self.point
        area = float(jnp.sum(here.reference.mass))
        shape = here.reference.times_mass(here.tangent_s) / area
        weight = here.tangent_g[-1]
        path = Path(self.direction, shape, weight, length + weight * here.g[-1])
        return self._corrected(path, length)

    def to(self, p: float):
        """Correct the prediction at a prescribed scaled parameter."""
        here = self.point
        length = (p - here.p) / float(here.tangent_g[-1])
        path = Path(
            self.direction, jnp.zeros_like(here.tangent_s), jnp.ones(()), jnp.asarray(float(p))
        )
        return self._corrected(path, length)

    def _corrected(self, path: Path, length: float) -> tuple[EquilibriumSystem, Solved]:
        here = self.point
        system = self._system(here.reference, path)
        g = here.g + length * here.tangent_g
        y = here.y + length * here.tangent_y
        solved = self.relaxation.solve(system, y, g, length * here.tangent_s)
        return system, solved

    def settled(self, system: EquilibriumSystem, solved: Solved):
        """The same parameter again, on the reference surface that belongs to the shape."""
        s, y, g = system.unpack(solved.unknowns)
        r = self.relaxation.reference(advanced(system.reference, s), concentration(y))
        path = Path(self.direction, jnp.zeros_like(s), jnp.ones(()), g[-1])
        return settle(self.relaxation, self._system(r, path), y, g)

    def accept(self, system: EquilibriumSystem, solved: Solved) -> None:
        """Move on: a new reference surface and the secant as seen from it."""
        here = self.point
        s, y, g = system.unpack(solved.unknowns)
        X = advanced(here.reference, s)
        r = self.relaxation.reference(X, concentration(y))
        step_s = jnp.sum((X - here.reference.X) * r.n, axis=1)
        area = jnp.sum(r.mass)
        norm = jnp.sqrt(jnp.sum(step_s * r.times_mass(step_s)) / area + (g[-1] - here.g[-1]) ** 2)
        steps = step_s, y - here.y, g - here.g
        self.point = _Point(r, y, g, *(step / norm for step in steps))


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
    observer: Callable[[dict[str, float], Equilibrium], bool | None] | None = None,
) -> Branch:
    r"""Follow a family of equilibria from one of them until a parameter reaches `stop`.

    Secant predictor, Newton corrector with a pseudo-arclength equation in the plane of normal
    displacement and parameter, so that folds are passed; after every point the reference surface
    moves to the shape with the least deformation. The last point has the parameter `stop` exactly.

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

    *Limits:* branches are not switched on purpose. Where another one crosses, the corrector may
    stay or change over: a change of `negative_directions` without a fold among the events, or a
    shape that has lost its symmetry, tells.
    """
    checked_known("branch", equilibrium=equilibrium, stop=stop)
    _check_stop(equilibrium, parameter, stop)
    follower = _Follower(equilibrium, parameter, tolerance, linear_solver)
    size = follower.scale
    step0 = 0.04 * size if step0 is None else abs(step0)
    limits = (
        (1e-4 * size if min_step is None else min_step) / size,
        (0.5 * size if max_step is None else max_step) / size,
    )
    follower.head(stop)
    run = _Run(follower, equilibrium, parameter, stability, self_contact, observer)
    result = run.follow(stop / size, step0 / size, limits, max_points)
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
        self.rows: list[dict[str, float]] = []
        self.events: list[tuple[int, str]] = []
        self.stopped = False
        self._add(start, follower.value, 0, 0.0)

    def follow(self, stop: float, length: float, limits, max_points: int) -> BRANCH_RESULTS:
        f = self.follower
        if self.stopped:
            return BRANCH_RESULTS.stopped
        if stop == f.point.p:
            return BRANCH_RESULTS.end_reached
        side = np.sign(stop - f.point.p)
        while len(self.points) <= max_points:
            if interrupted():
                return BRANCH_RESULTS.interrupted
            here = f.point
            ahead = here.p + length * float(here.tangent_g[-1])
            # Nearer to the end than the smallest step is at the end.
            last = side * (ahead - stop) >= -limits[0]
            system, solved = f.to(stop) if last else f.along(length)
            s, _, g = system.unpack(solved.unknowns)
            displaced = float(system.assessed(solved.unknowns).step)
            good = solved.converged and displaced < LARGEST_STEP
            if good and not last and side * (float(g[-1]) - stop) > 0:
                # The curve bent towards the end: take the rest in one step of known size.
                last = True
                system, solved = f.to(stop)
                good = solved.converged
            if good and last:
                final = f.settled(system, solved)
                good = final is not None
                system, solved = final if final is not None else (system, solved)
            if not good:
                length = length / 2
                if length < limits[0]:
                    return BRANCH_RESULTS.step_too_small
                continue
            trouble = self._record(system, solved, length)
            if trouble is not None or last:
                return BRANCH_RESULTS.end_reached if trouble is None else trouble
            previous = here.tangent_g[-1]
            f.accept(system, solved)
            if float(previous * f.point.tangent_g[-1]) < 0:
                self.events.append((len(self.points) - 1, "fold"))
            length = _next_length(length, int(solved.iterations), displaced, limits[1])
        return BRANCH_RESULTS.point_limit

    def _record(self, system, solved, length) -> BRANCH_RESULTS | None:
        """Keep a point, unless its mesh is no evidence; the reason to stop there, if any."""
        r = system.reference
        x = r.positions(system.unpack(solved.unknowns)[0])
        if not mesh_health(r.mesh, x).is_sound:
            return BRANCH_RESULTS.resolution_lost
        if self.self_contact and _pierces(r.mesh, x):
            return BRANCH_RESULTS.self_contact
        point = finished(
            system,
            solved,
            RESULTS.converged,
            self.follower.units,
            self.stability,
            self.follower.relaxation.linear_solver,
            {"newton_iterations": int(solved.iterations)},
        )
        value = float(solved.unknowns[-1]) * self.follower.scale
        self._add(point, value, int(solved.iterations), length * self.follower.scale)
        return BRANCH_RESULTS.stopped if self.stopped else None

    def _add(self, point: Equilibrium, value: float, iterations: int, step: float) -> None:
        row = _row(point, self.parameter, value, iterations, step)
        before = self.rows[-1]["negative_directions"] if self.rows else np.nan
        self.points.append(point)
        self.rows.append(row)
        now = row["negative_directions"]
        if np.isfinite(before) and np.isfinite(now) and before != now:
            event = f"negative directions {before:.0f} -> {now:.0f}"
            self.events.append((len(self.points) - 1, event))
        if self.observer is not None:
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

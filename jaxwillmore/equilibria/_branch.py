"""branch: a family of equilibria followed along a parameter, around folds."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..phases import checked_width
from ._family import Branch
from ._follow import Follower
from ._results import BRANCH_RESULTS, message, name_of
from ._shape import Equilibrium
from ._targets import SPHERE, checked_known, only_sphere
from ._walk import Walk

# Another step would be what the last attempts were.
_ENDS = (
    *(BRANCH_RESULTS.end_reached, BRANCH_RESULTS.step_too_small),
    *(BRANCH_RESULTS.resolution_lost, BRANCH_RESULTS.self_contact),
)


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
    resume: Branch | None = None,
    checkpoints: Callable[[Branch], object] | None = None,
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
    - `resume`: a branch from this start that ended early, or one that `checkpoints` handed out. It
      goes on as if it had not stopped: on the same machine all points are equal to the last bit,
      and `observer` sees those that were not known. `max_points` counts from the start and may be
      larger than before; the other arguments are those that the branch began with. A branch that
      reached its end, or could not go on, comes back as it is.
    - `checkpoints`: called with the branch so far, to go on from, at the start and after every
      step, for example `lambda found: jw.io.write_branch("branch.npz", found)`.

    **Raises:** `ValueError` for a parameter that the start does not allow, an impossible `stop`, or
    a branch to resume that began with something else, naming it.

    *Limits:* with `stability=False`, or a start that has no eigenvalues, bifurcations are passed
    without a word. A mesh whose symmetry does not hold that of the branch is an imperfection: there
    a pitchfork dissolves into a fold and a smooth bend, which may lead away; meshes of
    `mesh.from_sphere_map` are five-fold about z, and keep bodies of revolution about z on theirs.

    ```python
    found = jw.equilibria.branch(disc, stop=0.6, max_points=5)
    jw.io.write_branch("branch.npz", found)
    found = jw.io.read_branch("branch.npz")  # in another process
    found = jw.equilibria.branch(found.points[0], stop=0.6, resume=found)
    ```
    """
    checked_known("branch", equilibrium=equilibrium, stop=stop)
    _check_stop(equilibrium, parameter, stop)
    steps = {"step0": step0, "max_step": max_step, "min_step": min_step}
    settings = {
        **{"parameter": parameter, "stop": float(stop)},
        **{name: None if step is None else float(step) for name, step in steps.items()},
        **{"self_contact": self_contact, "stability": stability},
        **{"tolerance": tolerance, "linear_solver": linear_solver},
    }
    if resume is not None:
        _check_resume(resume, equilibrium, settings)
        # The start may differ by rounding where another machine made it.
        equilibrium = resume.points[0]
    follower = Follower(equilibrium, parameter, tolerance, linear_solver)
    size = follower.scale
    step0 = 0.04 * size if step0 is None else abs(step0)
    least = (1e-4 * size if min_step is None else min_step) / size
    largest = (0.5 * size if max_step is None else max_step) / size
    walk = Walk(follower, settings, observer, checkpoints)
    if resume is not None and any(bool(resume.result == end) for end in _ENDS):
        done = resume
    else:
        if resume is None or resume.continuation is None:
            walk.begin(equilibrium, stop, step0 / size, least)
        else:
            walk.go_on(resume, resume.continuation)
        done = walk.so_far(walk.follow(stop, least, largest, max_points))
    if throw and not (done.succeeded or bool(done.result == BRANCH_RESULTS.stopped)):
        last = done.rows[-1][parameter]
        raise RuntimeError(
            f"The branch ended at {parameter} = {last:.6g} of {stop:.6g} "
            f"({name_of(done.result)}): {message(done.result)}"
        )
    return done


def _check_resume(resume: Branch, start: Equilibrium, settings: dict[str, Any]) -> None:
    if not isinstance(resume, Branch):
        raise ValueError(f"`resume` must be a `Branch`; got {type(resume).__name__}.")
    if resume.continuation is not None:
        resume.continuation.check(resume.points[0], start, settings)


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

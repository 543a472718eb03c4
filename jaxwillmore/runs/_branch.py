"""The branch of equilibria that a case asks for, and the folder it is left in."""

import dataclasses
import os
import pathlib
import time
from collections.abc import Callable
from typing import Any

from .._interrupts import catch_interrupts
from ..cases import OF_PHASES, Case, CaseError
from ..equilibria import (
    Branch,
    BranchEvent,
    Equilibrium,
    branch,
    memory_estimate,
    message,
    name_of,
)
from ..io import RunFolder
from ..plot import branch_picture
from ._branch_recorder import BranchRecorder
from ._doubts import doubts
from ._equilibrium import (
    check_equilibrium,
    check_not_round,
    draw_shape,
    equilibrium_of,
    measures_of_start,
    notes_of,
    wanted_of,
    write_shape,
)
from ._inputs import stored_case
from ._output import INTERRUPTED, Existing, ending, fields_of, open_folder, pictures
from ._size import Announce, announced
from ._start import Start, starting_surface
from ._summary import end_of_equilibrium, health_of, provenance, warnings_of

_DONE = "end_reached"


@dataclasses.dataclass(frozen=True)
class CaseBranch:
    """A branch: its folder, what `summary.json` says, and its shapes."""

    folder: pathlib.Path
    summary: dict[str, Any]
    points: tuple[Equilibrium, ...]

    @property
    def succeeded(self) -> bool:
        """Whether the branch reached its end, in good health where that counts."""
        return self.summary["status"] == _DONE


@catch_interrupts()
def run_branch(
    case: Case,
    out: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    progress: Callable[[dict[str, Any]], None] | None = None,
    announce: Announce | None = None,
) -> CaseBranch:
    """Follow the branch of a case and leave its table, its shapes and its picture in a folder.

    Every converged shape is in the folder as soon as it exists, and stays there however the branch
    ends. `summary["status"]`, `["message"]` and `["ended_at"]` say why and where it did. Ctrl-C or
    SIGTERM end it before its next step, a second signal at once. `resume_branch` goes on with it,
    also after a kill.

    **Arguments:** as in `run_equilibrium`; `progress` is called with dictionaries of pseudo-time
    steps, then with the row of `branch.csv` for every point.

    **Raises:** `CaseError` for a case that has no branch; `RunFolderError` for a folder that cannot
    be used; `OSError` when the disk is full.

    ```python
    run = run_branch(load_case("example:discocytes", "branch"), "out/discocytes")
    ```
    """
    began = time.perf_counter()
    if case.branch is None:
        raise CaseError("the section [branch] is missing.", section="branch")
    _check_branch(case)
    start = starting_surface(case)
    wanted = wanted_of(case, start)
    needed = memory_estimate(start.mesh, two_phase=case.phase is not None)
    announced(needed, start.mesh, announce)
    stored = stored_case(case)
    with open_folder(out, existing) as folder:
        stored.write(folder)
        recorder = BranchRecorder(case, folder, progress, began)
        first = equilibrium_of(start, wanted, progress)
        found = followed(case, first, recorder) if first.succeeded else None
        return concluded(case, start, folder, recorder, first, found, notes_of(case))


def concluded(
    case: Case,
    start: Start,
    folder: RunFolder,
    recorder: BranchRecorder,
    first: Equilibrium,
    found: Branch | None,
    notes: list[str],
) -> CaseBranch:
    """Write what is left at the end of a branch.

    - `found`: `None` where there is no equilibrium to start from.
    """
    assert case.branch is not None
    if found is None:
        words = f"There is no equilibrium to start from. {message(first.result)}"
        status, points, rows, events = name_of(first.result), (), (), ()
    else:
        recorder.checkpoint(found)
        status, words = name_of(found.result), message(found.result)
        points, rows, events = found.points, recorder.rows, found.events
    last = points[-1] if points else first
    fields = write_shape(folder, last)
    recorder.note(warnings_of(case, last.mesh, last.x, fields["H"]))
    warned = [warning for _, warning in recorder.health.values()]
    status, words = ending(status, words, warned, case.output.fatal_warnings)
    summary = {
        "status": status,
        "message": words,
        "parameter": case.branch.parameter,
        "points": len(points),
        "ended_at": rows[-1] if rows else None,
        "events": [_event(event) for event in events],
        **end_of_equilibrium(case, last, fields["H"], measures_of_start(case, start)),
        "health": [
            {"point": number, **health_of([warning])[0]}
            for number, warning in recorder.health.values()
        ],
        "repairs": list(start.repairs),
        "warnings": doubts(points or [first]),
        "notes": notes,
        **provenance(recorder.seconds),
    }
    folder.write_summary(summary)
    if status != INTERRUPTED:
        folder.drop_previous_checkpoint()
    if case.output.picture:
        with pictures():
            draw_shape(folder, start, last, fields["H"])
            if points:
                _draw(folder, case.branch.parameter, recorder, status)
    return CaseBranch(folder.path, summary, tuple(points))


def followed(
    case: Case, first: Equilibrium, recorder: BranchRecorder, resume: Branch | None = None
) -> Branch:
    """The branch from its first shape, or from where it was stopped."""
    assert case.branch is not None
    try:
        return branch(
            first,
            case.branch.parameter,
            stop=case.branch.stop,
            step0=case.branch.step0,
            max_step=case.branch.max_step,
            min_step=case.branch.min_step,
            max_points=case.branch.max_points,
            self_contact=case.branch.self_contact,
            observer=recorder.point,
            resume=resume,
            checkpoints=recorder.checkpoint,
        )
    except ValueError as error:
        raise CaseError(str(error), section="branch") from error


def _event(event: BranchEvent) -> dict[str, Any]:
    return {
        "point": event.point,
        "event": event.event,
        "kind": event.kind,
        "value": event.value,
        "mode": event.mode,
        "negative_directions": event.negative_directions,
        "words": event.words,
    }


def _check_branch(case: Case) -> None:
    """Refuse, before anything is computed, a parameter that the constraints do not leave free."""
    check_equilibrium(case)
    assert case.branch is not None
    held = case.constraints
    holds_volume = held.volume is not None or held.reduced_volume is not None
    name = case.branch.parameter
    if name in OF_PHASES and (case.phase is None or case.phase.well != "quartic"):
        problem = 'is for two phases with well = "quartic": see [phase].'
        raise CaseError(problem, section="branch", key="parameter", got=name)
    if name == "spontaneous_curvature" and case.phase is not None:
        problem = f"is for one phase; with [phase] there are {', '.join(OF_PHASES)}."
        raise CaseError(problem, section="branch", key="parameter", got=name)
    if name == "reduced_volume" and not (holds_volume and held.area is not None):
        problem = '"reduced_volume" needs area and volume held: see [constraints].'
        raise CaseError(problem, section="branch", key="parameter", got=name)
    if name == "reduced_volume":
        check_not_round("branch", "stop", case.branch.stop)
    if name == "pressure" and holds_volume:
        problem = '"pressure" needs a free volume: take it out of [constraints].'
        raise CaseError(problem, section="branch", key="parameter", got=name)


def _draw(folder: RunFolder, parameter: str, recorder: BranchRecorder, status: str) -> None:
    points = recorder.points
    field = "H" if points[0].c is None else "c"
    surfaces = [(shape.mesh, shape.x, fields_of(shape)[field]) for shape in points]
    title = f"{len(points)} equilibria, {status.replace('_', ' ')}"
    if status != _DONE:
        last = recorder.rows[-1]
        title += f" at {parameter.replace('_', ' ')} = {last[parameter]:.4g}"
    branch_picture(
        folder.file("branch.png"),
        recorder.rows,
        surfaces,
        parameter,
        energy="bending_over_8pi_kappa" if field == "H" else "total_energy",
        field_name=field,
        title=title,
    )

"""The branch of equilibria that a case asks for, and the folder it is left in."""

import dataclasses
import os
import pathlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from .._interrupts import catch_interrupts, interrupted
from ..cases import OF_PHASES, Case, CaseError
from ..equilibria import BranchEvent, Equilibrium, branch, memory_estimate, message, name_of
from ..health import HealthWarning, health_warnings
from ..io import RunFolder
from ..plot import branch_picture
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
from ._output import Existing, ending, fields_of, open_folder, pictures
from ._size import Announce, announced
from ._start import starting_surface
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
    SIGTERM end it before its next step, a second signal at once.

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
        recorder = _Recorder(case, folder, progress)
        first = equilibrium_of(start, wanted, progress)
        status, words, events = _followed(case, first, recorder)
        last = recorder.points[-1] if recorder.points else first
        fields = write_shape(folder, last)
        recorder.note(warnings_of(case, last.mesh, last.x, fields["H"]))
        found = [warning for _, warning in recorder.health.values()]
        status, words = ending(status, words, found, case.output.fatal_warnings)
        summary = {
            "status": status,
            "message": words,
            "parameter": case.branch.parameter,
            "points": len(recorder.points),
            "ended_at": recorder.rows[-1] if recorder.rows else None,
            "events": [_event(event) for event in events],
            **end_of_equilibrium(case, last, fields["H"], measures_of_start(case, start)),
            "health": [
                {"point": number, **health_of([warning])[0]}
                for number, warning in recorder.health.values()
            ],
            "repairs": list(start.repairs),
            "warnings": doubts(recorder.points or [first]),
            "notes": notes_of(case),
            **provenance(time.perf_counter() - began),
        }
        folder.write_summary(summary)
        if case.output.picture:
            with pictures():
                draw_shape(folder, start, last, fields["H"])
                if recorder.points:
                    _draw(folder, case.branch.parameter, recorder, status)
    return CaseBranch(folder.path, summary, tuple(recorder.points))


class _Recorder:
    """Keeps every point of a branch, on disk at once."""

    def __init__(self, case: Case, folder: RunFolder, progress):
        self._case, self._folder, self._progress = case, folder, progress
        self.points: list[Equilibrium] = []
        self.rows: list[dict[str, Any]] = []
        self.health: dict[str, tuple[int, HealthWarning]] = {}

    def point(self, row: dict[str, Any], shape: Equilibrium) -> bool:
        """Write one point; whether the branch is to end there."""
        number, fields = len(self.points), fields_of(shape)
        self.points.append(shape)
        self.rows.append({"point": number, **row})
        self._folder.write_shape(number, shape.mesh, shape.x, fields)
        self._folder.branch.append(self.rows[-1])
        self.note(health_warnings(shape.mesh, shape.x, fields["H"]))
        if self._progress is not None:
            self._progress(self.rows[-1])
        # An interrupt ends the branch anyway, and is then why it ended.
        return bool(self.health) and self._case.output.fatal_warnings and not interrupted()

    def note(self, found: Iterable[HealthWarning]) -> None:
        """Remember warnings of the last point, each kind where it first appeared."""
        for warning in found:
            self.health.setdefault(warning.kind, (max(len(self.points) - 1, 0), warning))


def _followed(case: Case, first: Equilibrium, recorder: _Recorder):
    """Status, message and events of the branch from its first shape."""
    assert case.branch is not None
    if not first.succeeded:
        words = f"There is no equilibrium to start from. {message(first.result)}"
        return name_of(first.result), words, ()
    try:
        found = branch(
            first,
            case.branch.parameter,
            stop=case.branch.stop,
            step0=case.branch.step0,
            max_step=case.branch.max_step,
            min_step=case.branch.min_step,
            max_points=case.branch.max_points,
            self_contact=case.branch.self_contact,
            observer=recorder.point,
        )
    except ValueError as error:
        raise CaseError(str(error), section="branch") from error
    return name_of(found.result), message(found.result), found.events


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


def _draw(folder: RunFolder, parameter: str, recorder: _Recorder, status: str) -> None:
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

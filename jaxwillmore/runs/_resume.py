"""Go on with a run in its own folder."""

import dataclasses
import json
import os
import pathlib
import time
from collections.abc import Callable
from typing import Any

from .._interrupts import catch_interrupts
from ..cases import Case, CaseError, load_case
from ..evolve import memory_estimate, name_of
from ..io import Checkpoint, RunFolder, RunFolderError, SolutionError
from ._flow import flow_of
from ._inputs import stored_case
from ._output import INTERRUPTED
from ._recorder import Recorder
from ._run import CaseRun, performed
from ._size import Announce, announced
from ._start import starting_surface


@catch_interrupts()
def resume_case(
    out: str | os.PathLike[str],
    *,
    t1: float | None = None,
    max_steps: int | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    announce: Announce | None = None,
) -> CaseRun:
    """Go on with the run in a folder that was interrupted or killed, or met a full disk.

    The run goes on from its checkpoint as if it had not stopped: on the same machine, with the same
    versions, everything that it leaves is the same to the last bit. Elsewhere it is equal to
    tolerance, and `summary["notes"]` says so. Frames and rows of the history that are later than
    the checkpoint are written again.

    A run that had ended is left as it is, and `summary["notes"]` says that too; unless it reached
    `t1` or its step limit, and these are raised. Its last steps were chosen to meet the old `t1`;
    it goes on from there.

    **Arguments:**

    - `out`: the folder.
    - `t1`, `max_steps`: larger ones than those of the case, which `case.toml` then has.
    - `progress`, `announce`: as of `run_case`.

    **Raises:** `RunFolderError` for a folder without a run to go on with, saying what to do; what
    `run_case` raises.

    ```python
    run = resume_case("out/torus")
    ```
    """
    began = time.perf_counter()
    with open_resumed(out, "run") as folder:
        checkpoint = checkpoint_of(
            folder, "run", lambda: folder.read_checkpoint(lambda found: _check(folder, found))
        )
        case = load_case(folder.path / "case.toml", "run")
        longer = _extended(case, t1, max_steps)
        ended = _ended(folder, checkpoint, longer != case)
        if ended is not None:
            return ended
        start = starting_surface(longer)
        # The start may differ by rounding where another machine made it.
        start = start._replace(x=checkpoint.solution.continuation.origin.x0)
        flow = flow_of(longer, start.mesh, start.x)
        announced(memory_estimate(flow, start.mesh), start.mesh, announce)
        recorder = Recorder(longer, folder, flow, progress)
        try:
            recorder.go_on(checkpoint)
            if longer != case:
                stored_case(longer).write(folder)
            return performed(longer, start, flow, folder, recorder, began, checkpoint)
        except ValueError as error:
            if isinstance(error, CaseError):
                raise
            raise RunFolderError(f"`{folder.path}` cannot go on: {error}") from error


def open_resumed(out: str | os.PathLike[str], command: str) -> RunFolder:
    """The folder of a run that is to go on.

    **Raises:** `RunFolderError` where there is none.
    """
    path = pathlib.Path(out)
    if not (path / "case.toml").is_file():
        raise RunFolderError(f"`{path}` holds no {command} to go on with: it has no `case.toml`.")
    return RunFolder(path, "resume")


def checkpoint_of(folder: RunFolder, command: str, read: Callable[[], Any]) -> Any:
    """What `read` finds in a folder.

    **Raises:** `RunFolderError` where there is none that can be used, with what to do.
    """
    where = folder.path
    again = f"jaxwillmore {command} {where / 'case.toml'} --out {where} --replace"
    try:
        return read()
    except FileNotFoundError:
        raise RunFolderError(
            f"`{where}` holds no checkpoint to go on from: the {command} had not begun its first "
            f"step. Start it again: {again}"
        ) from None
    except SolutionError as error:
        raise RunFolderError(f"{error} To start it again: {again}") from error


def _check(folder: RunFolder, found: Checkpoint) -> None:
    """Whether a checkpoint, and what was written beside it, are those of this folder.

    **Raises:** `ValueError`.
    """
    known, solution = found.metadata, found.solution
    names = {"frames": int, "rows": int, "rejected_steps": int, "last_frame": float | int}
    wrong = [name for name, kind in names.items() if not isinstance(known.get(name), kind)]
    if wrong or "first_amount" not in known or not solution.saved:
        raise ValueError(f"it does not say where its run stood ({', '.join(wrong)}).")
    if known["rows"] != len(solution.records) + 1:
        raise ValueError(
            f"it was written after {known['rows']} rows of history, and its run has "
            f"{len(solution.records)} steps."
        )
    folder.check_kept(known["frames"], known["rows"])


def _extended(case: Case, t1: float | None, max_steps: int | None) -> Case:
    """The case with a later end, if one is asked for."""
    assert case.time is not None
    changes = {}
    for key, value, now in (
        ("t1", t1, case.time.t1),
        ("max_steps", max_steps, case.time.max_steps),
    ):
        if value is None:
            continue
        if not value >= now:
            problem = f"may only be raised when a run goes on; it is {now:g} and got {value:g}."
            raise CaseError(problem, section="time", key=key, got=value)
        changes[key] = value
    return dataclasses.replace(case, time=dataclasses.replace(case.time, **changes))


def _ended(folder: RunFolder, checkpoint: Checkpoint, is_longer: bool) -> CaseRun | None:
    """The run as it stands in its folder, if it has ended."""
    result = name_of(checkpoint.solution.result)
    if result == INTERRUPTED or (is_longer and result in ("reached_t1", "step_limit")):
        return None
    summary = summary_in(folder)
    if summary is None:
        return None
    status = summary["status"]
    how = {
        "reached_t1": "; a larger `t1` lets it go further",
        "step_limit": "; a larger `max_steps` lets it go on",
    }
    words = f"the run had ended ({status}), and nothing was computed{how.get(status, '')}"
    notes = [*summary.get("notes", ()), words]
    return CaseRun(folder.path, summary | {"notes": notes}, checkpoint.solution)


def summary_in(folder: RunFolder) -> dict[str, Any] | None:
    """The summary of a run that has ended; `None` where it was killed before that was written."""
    try:
        summary = json.loads((folder.path / "summary.json").read_text(encoding="utf-8"))
        return summary if isinstance(summary["status"], str) else None
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None

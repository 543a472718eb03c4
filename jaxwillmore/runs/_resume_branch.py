"""Go on with a branch in its own folder."""

import dataclasses
import os
import time
from collections.abc import Callable
from typing import Any

from .._interrupts import catch_interrupts
from ..cases import Case, CaseError, load_case
from ..equilibria import Branch, memory_estimate, name_of
from ..io import BranchCheckpoint, RunFolder, RunFolderError
from ._branch import CaseBranch, concluded, followed
from ._branch_recorder import BranchRecorder
from ._equilibrium import notes_of
from ._inputs import stored_case
from ._output import INTERRUPTED
from ._resume import checkpoint_of, open_resumed, summary_in
from ._size import Announce, announced
from ._start import starting_surface


@catch_interrupts()
def resume_branch(
    out: str | os.PathLike[str],
    *,
    max_points: int | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    announce: Announce | None = None,
) -> CaseBranch:
    """Go on with the branch in a folder that was interrupted or killed, or met a full disk.

    The branch goes on from its checkpoint, which holds all its points, as if it had not stopped: on
    the same machine, with the same versions, everything that it leaves is the same to the last bit.
    Elsewhere it is equal to tolerance, and `summary["notes"]` says so. Table and shapes that are
    later than the checkpoint are written again, and so are those that are lost.

    A branch that had ended is left as it is, and `summary["notes"]` says that too; unless it had
    as many points as were allowed, and more are now.

    **Arguments:**

    - `out`: the folder.
    - `max_points`: a larger number than that of the case, which `case.toml` then has.
    - `progress`, `announce`: as of `run_branch`.

    **Raises:** `RunFolderError` for a folder without a branch to go on with, saying what to do;
    what `run_branch` raises.

    ```python
    run = resume_branch("out/discocytes")
    ```
    """
    began = time.perf_counter()
    with open_resumed(out, "branch") as folder:
        checkpoint = checkpoint_of(folder, "branch", lambda: folder.read_branch_checkpoint(_check))
        case = load_case(folder.path / "case.toml", "branch")
        longer, found = _extended(case, max_points), checkpoint.branch
        ended = _ended(folder, found, longer != case)
        if ended is not None:
            return ended
        start = starting_surface(longer)
        needed = memory_estimate(start.mesh, two_phase=longer.phase is not None)
        announced(needed, start.mesh, announce)
        recorder = BranchRecorder(longer, folder, progress, began)
        recorder.go_on(checkpoint)
        if longer != case:
            stored_case(longer).write(folder)
        if name_of(found.result) != "stopped":
            found = _followed(longer, found, folder, recorder)
        notes = [*notes_of(longer), *checkpoint.notes]
        return concluded(longer, start, folder, recorder, found.points[0], found, notes)


def _followed(case: Case, found: Branch, folder: RunFolder, recorder: BranchRecorder) -> Branch:
    try:
        return followed(case, found.points[0], recorder, found)
    except CaseError as error:
        raise RunFolderError(f"`{folder.path}` cannot go on: {error}") from error


def _check(found: BranchCheckpoint) -> None:
    """Whether a checkpoint was written by a run.

    **Raises:** `ValueError`.
    """
    if not isinstance(found.metadata.get("wall_seconds"), float | int):
        raise ValueError("it does not say how long its branch took.")


def _extended(case: Case, max_points: int | None) -> Case:
    """The case with more points, if they are asked for."""
    assert case.branch is not None
    now = case.branch.max_points
    if max_points is None:
        return case
    if not max_points >= now:
        problem = f"may only be raised when a branch goes on; it is {now} and got {max_points}."
        raise CaseError(problem, section="branch", key="max_points", got=max_points)
    return dataclasses.replace(case, branch=dataclasses.replace(case.branch, max_points=max_points))


def _ended(folder: RunFolder, found: Branch, is_longer: bool) -> CaseBranch | None:
    """The branch as it stands in its folder, if it has ended."""
    result = name_of(found.result)
    if result == INTERRUPTED or (is_longer and result == "point_limit"):
        return None
    summary = summary_in(folder)
    if summary is None:
        return None
    status = summary["status"]
    more = "; a larger `max_points` lets it go on" if status == "point_limit" else ""
    words = f"the branch had ended ({status}), and nothing was computed{more}"
    notes = [*summary.get("notes", ()), words]
    return CaseBranch(folder.path, summary | {"notes": notes}, found.points)

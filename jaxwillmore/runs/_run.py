"""From a case to a folder full of results."""

import dataclasses
import os
import pathlib
import time
from collections.abc import Callable
from typing import Any

from .._interrupts import catch_interrupts
from ..cases import Case, CaseError, MeshCase
from ..evolve import (
    Checkpoints,
    NewMesh,
    Remeshing,
    Solution,
    State,
    evolve,
    memory_estimate,
    message,
    name_of,
)
from ..flows import System
from ..io import Checkpoint, RunFolder, read_history
from ..plot import history_picture, surface_picture
from ._flow import flow_of
from ._inputs import stored_case
from ._output import INTERRUPTED, UNHEALTHY, Existing, ending, open_folder, pictures
from ._recorder import Recorder, frame_fields
from ._size import Announce, announced
from ._start import Start, starting_surface
from ._summary import end_of_flow, health_of, provenance, reference_energies


@dataclasses.dataclass(frozen=True)
class CaseRun:
    """A finished run: its folder, what `summary.json` says, and the solution itself."""

    folder: pathlib.Path
    summary: dict[str, Any]
    solution: Solution

    @property
    def succeeded(self) -> bool:
        """Whether the end time or a stationary shape was reached, in good health if that counts."""
        return self.solution.succeeded and self.summary["status"] != UNHEALTHY


@catch_interrupts()
def run_case(
    case: Case,
    out: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    progress: Callable[[dict[str, Any]], None] | None = None,
    announce: Announce | None = None,
) -> CaseRun:
    """Run a case and leave case, history, frames, final state, summary and pictures in a folder.

    Everything is written as soon as it exists. A run that fails, or is interrupted by Ctrl-C or
    SIGTERM, keeps its frames, its history and the last good state; `summary["status"]` and
    `summary["message"]` say why it stopped, `summary["health"]` what speaks against the result.
    A second signal ends it at once. `resume_case` goes on with it, also after a kill.

    **Arguments:**

    - `out`: the folder; it is made, parents included.
    - `existing`: what to do with an earlier run in the folder.
    - `progress`: called with the row of `history.csv` after every accepted step.
    - `announce`: called with a line about nodes and memory before anything is computed.

    **Raises:** `CaseError` for a case that gives no surface, or needs more memory than there is;
    `RunFolderError` for a folder that cannot be used; `OSError` when the disk is full.

    ```python
    run = run_case(load_case("example:torus"), "out/torus")
    ```
    """
    began = time.perf_counter()
    if case.time is None:
        raise CaseError("the section [time] is missing.", section="time")
    start = starting_surface(case)
    flow = flow_of(case, start.mesh, start.x)
    announced(memory_estimate(flow, start.mesh), start.mesh, announce)
    stored = stored_case(case)
    with open_folder(out, existing) as folder:
        stored.write(folder)
        recorder = Recorder(case, folder, flow, progress)
        return performed(case, start, flow, folder, recorder, began)


def performed(
    case: Case,
    start: Start,
    flow: System,
    folder: RunFolder,
    recorder: Recorder,
    began: float,
    checkpoint: Checkpoint | None = None,
) -> CaseRun:
    """Run the flow, from a checkpoint where there is one, and write what is left at the end."""
    resume = None if checkpoint is None else checkpoint.solution
    solution = _evolved(case, flow, start, recorder, resume)
    last = solution.state
    # Before the frame of the last state, which a run that goes on does not have.
    recorder.checkpoint(solution)
    recorder.finish(last)
    folder.write_final(last.mesh, last.x, frame_fields(last))
    rows = read_history(folder.history.path)
    found = recorder.fatal or recorder.warnings(last)
    status, words = name_of(solution.result), message(solution.result)
    if recorder.fatal:
        status, words = UNHEALTHY, found[0].message
    else:
        status, words = ending(status, words, found, case.output.fatal_warnings)
    # The time of the processes that were stopped belongs to the run.
    earlier = 0.0 if resume is None else resume.stats["wall_seconds"]
    summary = {
        "status": status,
        "message": words,
        "t": last.t,
        "singular_time": solution.stats.get("singular_time"),
        **_counts(solution.stats),
        "remeshings": [_told(new) for new in solution.new_meshes],
        **end_of_flow(case, last, rows),
        "health": health_of(found),
        "repairs": list(start.repairs),
        "notes": [*([] if checkpoint is None else checkpoint.notes), *_refused(solution.stats)],
        **provenance(time.perf_counter() - began + earlier),
    }
    folder.write_summary(summary)
    if status != INTERRUPTED:
        folder.drop_previous_checkpoint()
    if case.output.picture:
        with pictures():
            _draw(folder, solution, recorder.first, rows, summary)
    return CaseRun(folder.path, summary, solution)


def _evolved(
    case: Case, flow: System, start: Start, recorder: Recorder, resume: Solution | None
) -> Solution:
    assert case.time is not None
    return evolve(
        flow,
        start.mesh,
        start.x,
        t0=case.time.t0,
        t1=case.time.t1,
        dt0=case.time.dt0,
        initial={k: v for k, v in start.initial.items() if k in flow.evolving},
        bdf_order=case.flow.bdf_order,
        scheme=case.flow.scheme,
        rtol=case.time.rtol,
        stationary_tolerance=case.time.stop_when_stationary or None,
        self_contact=case.time.self_contact,
        remesh=_remeshing(case.mesh),
        saveat=case.output.every,
        max_steps=case.time.max_steps,
        throw=False,
        observer=recorder.step,
        on_save=recorder.save,
        resume=resume,
        checkpoints=Checkpoints(
            recorder.checkpoint, case.output.checkpoint_minutes, case.output.checkpoint_steps
        ),
    )


def _remeshing(mesh: MeshCase) -> Remeshing | None:
    if mesh.remesh_when is None:
        return None
    return Remeshing(
        least_angle=mesh.remesh_when,
        size=mesh.remesh_size,
        every=mesh.remesh_every,
        energy_change=mesh.remesh_energy_change,
    )


def _told(new: NewMesh) -> dict[str, Any]:
    return {"step": new.step, "t": new.t, **new.changes}


def _refused(stats: dict[str, Any]) -> list[str]:
    count = stats.get("refused_remeshings", 0)
    if not count:
        return []
    used = "1 new mesh was" if count == 1 else f"{count} new meshes were"
    return [f"{used} made and not used; the last one because: {stats['refused_because']}"]


def _counts(stats: dict[str, Any]) -> dict[str, int]:
    names = ("steps", "rejected_steps", "newton_iterations", "linear_iterations")
    return {name.replace("linear", "krylov"): stats[name] for name in names}


def _draw(folder: RunFolder, solution: Solution, first: State | None, rows, summary) -> None:
    last = solution.state
    assert first is not None
    name = "c" if "c" in last.fields else "H"
    last_words, first_words = f"t = {last.t:.4g}", f"t = {first.t:.4g}"
    if name == "H":
        last_words += f",  ½∫H² = {summary['willmore']:.6g}"
        first_words += f",  ½∫H² = {summary['start']['willmore']:.6g}"
    else:
        last_words += f",  E = {summary['energy']:.6g}"
        first_words += f",  E = {summary['start']['energy']:.6g}"
    surface_picture(
        folder.file("final.png"),
        last.mesh,
        last.x,
        last.fields[name],
        field_name=name,
        contour=0.5 if name == "c" else None,
        caption=last_words,
        start=(first.mesh, first.x),
        start_field=first.fields[name],
        start_caption=first_words,
    )
    reference = reference_energies(last.mesh.genus)
    title = f"{summary['status'].replace('_', ' ')} at t = {last.t:.4g}"
    history_picture(folder.file("history.png"), rows, reference=reference, title=title)

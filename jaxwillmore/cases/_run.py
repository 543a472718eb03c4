"""From a case to a folder full of results."""

import dataclasses
import os
import pathlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from .._interrupts import catch_interrupts, interrupted
from ..evolve import Solution, State, evolve, memory_estimate, message, name_of
from ..health import HealthWarning, health_warnings
from ..io import RunFolder, read_history
from ..mesh import SurfaceMesh
from ..plot import history_picture, surface_picture
from ..surface import recover_mean_curvature, recover_normal
from ._case import Case
from ._error import CaseError
from ._flow import flow_of
from ._inputs import stored_case
from ._output import UNHEALTHY, Existing, ending, gaussian_curvature, open_folder, pictures
from ._phase_record import PhaseRecord, warnings_of_phase
from ._size import Announce, announced
from ._start import Start, starting_surface
from ._summary import (
    end_of_flow,
    first_record,
    health_of,
    provenance,
    reference_energies,
    row_of,
    warnings_of,
)


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
    A second signal ends it at once.

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
        recorder = _Recorder(case, folder, flow, start.mesh, progress)
        solution = _evolved(case, flow, start, recorder)
        last = solution.state
        recorder.finish(last)
        folder.write_final(start.mesh, last.x, frame_fields(start.mesh, last))
        rows = read_history(folder.history.path)
        found = recorder.fatal or recorder.warnings(last)
        status, words = name_of(solution.result), message(solution.result)
        if recorder.fatal:
            status, words = UNHEALTHY, found[0].message
        else:
            status, words = ending(status, words, found, case.output.fatal_warnings)
        summary = {
            "status": status,
            "message": words,
            "t": last.t,
            **_counts(solution.stats),
            **end_of_flow(case, start.mesh, last, rows),
            "health": health_of(found),
            "repairs": list(start.repairs),
            **provenance(time.perf_counter() - began),
        }
        folder.write_summary(summary)
        if case.output.picture:
            with pictures():
                _draw(folder, solution, recorder.first, rows, summary)
    return CaseRun(folder.path, summary, solution)


def _evolved(case: Case, flow, start: Start, recorder: "_Recorder") -> Solution:
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
        saveat=case.output.every,
        max_steps=case.time.max_steps,
        throw=False,
        observer=recorder.step,
        on_save=recorder.save,
    )


def _counts(stats: dict[str, Any]) -> dict[str, int]:
    names = ("steps", "rejected_steps", "newton_iterations", "linear_iterations")
    return {name.replace("linear", "krylov"): stats[name] for name in names}


class _Recorder:
    """Writes a run while it goes on; what it has written last is all it remembers."""

    def __init__(self, case: Case, folder: RunFolder, flow, mesh: SurfaceMesh, progress):
        self._case, self._folder, self._flow, self._mesh = case, folder, flow, mesh
        self._progress = progress
        self._rejected_steps = 0
        self._last_frame: float | None = None
        self._phase = None if case.phase is None else PhaseRecord(case, mesh)
        self.first: State | None = None
        self.first_amount: float | None = None
        self.fatal: tuple[HealthWarning, ...] = ()

    def step(self, record: dict[str, Any], state: State) -> bool:
        """A line of history, rejections counted from the start; whether the run is to end."""
        self._rejected_steps += record["rejected_steps"]
        row = row_of(record | self._extra(state) | {"rejected_steps": self._rejected_steps})
        self._folder.append_history(row)
        if self._progress is not None:
            self._progress(row)
        # An interrupt ends the run after this step anyway, and is then why it ended.
        if self._case.output.fatal_warnings and not interrupted():
            self.fatal = health_warnings(self._mesh, state.x, state.fields.get("H"))
            self.fatal += self._of_phase(state)
        return bool(self.fatal)

    def _extra(self, state: State) -> dict[str, float]:
        return {} if self._phase is None else self._phase.columns(state)

    def warnings(self, state: State) -> tuple[HealthWarning, ...]:
        """What speaks against a state."""
        found = warnings_of(self._case, self._mesh, state.x, state.fields.get("H"))
        return found + self._of_phase(state)

    def _of_phase(self, state: State) -> tuple[HealthWarning, ...]:
        if self._phase is None:
            return ()
        return warnings_of_phase(self._case, self._mesh, state, self.first_amount)

    def save(self, state: State) -> None:
        """A frame; the first one comes before the first step and starts the history too."""
        if self._last_frame is None:
            self.first = state
            record = first_record(self._flow, self._mesh, state)
            self.first_amount = record.get("phase_amount")
            self._folder.append_history(row_of(record | self._extra(state)))
        self._last_frame = state.t
        if self._case.output.frames:
            fields = frame_fields(self._mesh, state)
            self._folder.write_frame(state.t, self._mesh, state.x, fields)

    def finish(self, state: State) -> None:
        """The frame of the last state, unless it has been written."""
        if self._last_frame is None or state.t > self._last_frame:
            self.save(state)


def frame_fields(mesh: SurfaceMesh, state: State) -> dict[str, Any]:
    """What a frame shows: H, K, the normal, the velocity, c and μ.

    Velocity and μ are NaN before the first step: all frames of a series have the same fields.
    """
    lost = np.full(mesh.n_nodes, np.nan)
    shown = {name: state.fields.get(name, lost) for name in ("c", "mu") if "c" in state.fields}
    if "H" not in state.fields:
        H, nu = recover_mean_curvature(mesh, state.x), recover_normal(mesh, state.x)
        return {"H": H, "K": gaussian_curvature(mesh, state.x, H, nu), "normal": nu} | shown
    velocity = np.asarray(state.fields.get("V", lost))[:, None] * np.asarray(state.nu)
    K = gaussian_curvature(mesh, state.x, state.H, state.nu)
    return {"H": state.H, "K": K, "normal": state.nu, "velocity": velocity} | shown


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
        solution.mesh,
        last.x,
        last.fields[name],
        field_name=name,
        contour=0.5 if name == "c" else None,
        caption=last_words,
        start=first.x,
        start_field=first.fields[name],
        start_caption=first_words,
    )
    reference = reference_energies(solution.mesh.genus)
    title = f"{summary['status'].replace('_', ' ')} at t = {last.t:.4g}"
    history_picture(folder.file("history.png"), rows, reference=reference, title=title)

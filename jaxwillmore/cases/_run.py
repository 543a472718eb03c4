"""From a case to a folder full of results."""

import dataclasses
import os
import pathlib
import time
import warnings
from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
from jaxtyping import Array, Float

from ..evolve import Solution, State, evolve
from ..io import RunFolder, RunFolderError, read_history
from ..mesh import SurfaceMesh
from ..plot import PlotError, history_picture, surface_picture
from ..surface import nodal_weingarten_squared
from ._case import Case
from ._flow import flow_of
from ._start import starting_surface
from ._summary import first_record, reference_energies, row_of, summary_of


@dataclasses.dataclass(frozen=True)
class CaseRun:
    """A finished run: its folder, what `summary.json` says, and the solution itself."""

    folder: pathlib.Path
    summary: dict[str, Any]
    solution: Solution

    @property
    def succeeded(self) -> bool:
        """Whether the end time or a stationary shape was reached."""
        return self.solution.succeeded


def run_case(
    case: Case,
    out: str | os.PathLike[str],
    *,
    existing: Literal["refuse", "replace"] = "refuse",
    progress: Callable[[dict[str, Any]], None] | None = None,
) -> CaseRun:
    """Run a case and leave case, history, frames, final state, summary and pictures in a folder.

    Everything is written as soon as it exists. A run that fails, or is interrupted by Ctrl-C or
    SIGTERM, keeps its frames, its history and the last good state; `summary["status"]` and
    `summary["message"]` say why it stopped.

    **Arguments:**

    - `out`: the folder; it is made, parents included.
    - `existing`: what to do with an earlier run in the folder.
    - `progress`: called with the row of `history.csv` after every accepted step.

    **Raises:** `CaseError` for a case that gives no surface; `RunFolderError` for a folder that
    cannot be used; `OSError` when the disk is full.

    ```python
    run = run_case(load_case("example:torus"), "out/torus")
    ```
    """
    began = time.perf_counter()
    start = starting_surface(case)
    flow = flow_of(case, start.mesh, start.x)
    with _folder(out, existing) as folder:
        folder.write_text("case.toml", case.to_toml())
        recorder = _Recorder(case, folder, flow, start.mesh, progress)
        solution = evolve(
            flow,
            start.mesh,
            start.x,
            t0=case.time.t0,
            t1=case.time.t1,
            dt0=case.time.dt0,
            initial=start.initial,
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
        last = solution.state
        recorder.finish(last)
        folder.write_final(start.mesh, last.x, frame_fields(start.mesh, last))
        rows = read_history(folder.history.path)
        summary = summary_of(case, solution, rows, time.perf_counter() - began)
        folder.write_summary(summary)
        if case.output.picture:
            _draw(folder, solution, rows, summary)
    return CaseRun(folder.path, summary, solution)


class _Recorder:
    """Writes a run while it goes on; what it has written last is all it remembers."""

    def __init__(self, case: Case, folder: RunFolder, flow, mesh: SurfaceMesh, progress):
        self._case, self._folder, self._flow, self._mesh = case, folder, flow, mesh
        self._progress = progress
        self._rejected_steps = 0
        self._last_frame: float | None = None

    def step(self, record: dict[str, Any], state: State) -> None:
        """A line of history; rejections are counted from the start of the run."""
        self._rejected_steps += record["rejected_steps"]
        row = row_of(record | {"rejected_steps": self._rejected_steps})
        self._folder.append_history(row)
        if self._progress is not None:
            self._progress(row)

    def save(self, state: State) -> None:
        """A frame; the first one comes before the first step and starts the history too."""
        if self._last_frame is None:
            self._folder.append_history(row_of(first_record(self._flow, self._mesh, state)))
        self._last_frame = state.t
        if self._case.output.frames:
            fields = frame_fields(self._mesh, state)
            self._folder.write_frame(state.t, self._mesh, state.x, fields)

    def finish(self, state: State) -> None:
        """The frame of the last state, unless it has been written."""
        if self._last_frame is None or state.t > self._last_frame:
            self.save(state)


def frame_fields(mesh: SurfaceMesh, state: State) -> dict[str, Array]:
    """What a frame shows: H, K, the normal, and the velocity (NaN before the first step)."""
    return {
        "H": state.H,
        "K": _gaussian_curvature(mesh, state.x, state.H, state.nu),
        "normal": state.nu,
        "velocity": state.V[:, None] * state.nu,
    }


@eqx.filter_jit
def _gaussian_curvature(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    H: Float[Array, " nodes"],
    nu: Float[Array, "nodes 3"],
) -> Float[Array, " nodes"]:
    """K = ½(H² − |A|²), node by node."""
    return 0.5 * (H**2 - nodal_weingarten_squared(mesh, x, nu))


def _folder(out: str | os.PathLike[str], existing: Literal["refuse", "replace"]) -> RunFolder:
    parent = pathlib.Path(out).parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunFolderError(f"cannot make the folder `{parent}`: {error.strerror}.") from error
    return RunFolder(out, existing)


def _draw(folder: RunFolder, solution: Solution, rows, summary: dict[str, Any]) -> None:
    """Pictures are a help: a run without them is a good run, and says so."""
    first, last = solution.saved[0], solution.state
    title = f"{summary['status'].replace('_', ' ')} at t = {last.t:.4g}"
    try:
        surface_picture(
            folder.file("final.png"),
            solution.mesh,
            last.x,
            last.H,
            field_name="H",
            caption=f"t = {last.t:.4g},  ½∫H² = {summary['willmore']:.6g}",
            start=first.x,
            start_field=first.H,
            start_caption=f"t = {first.t:.4g},  ½∫H² = {summary['start']['willmore']:.6g}",
        )
        reference = reference_energies(solution.mesh.genus)
        history_picture(folder.file("history.png"), rows, reference=reference, title=title)
    except PlotError as error:
        warnings.warn(f"no picture: {error}", UserWarning, stacklevel=3)

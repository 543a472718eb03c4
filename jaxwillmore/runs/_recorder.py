"""What a run leaves in its folder while it goes on."""

import dataclasses
import warnings
from typing import Any

import numpy as np

from .._interrupts import interrupted
from ..cases import Case
from ..evolve import Solution, State
from ..health import HealthWarning, health_warnings
from ..io import Checkpoint, RunFolder
from ..surface import recover_mean_curvature, recover_normal
from ._output import gaussian_curvature
from ._phase_record import PhaseRecord, warnings_of_phase
from ._summary import first_record, row_of, warnings_of


class Recorder:
    """Writes a run while it goes on; what it has written last is all it remembers."""

    def __init__(self, case: Case, folder: RunFolder, flow, progress):
        self._case, self._folder, self._flow = case, folder, flow
        self._progress = progress
        self._rejected_steps, self._rows, self._frames = 0, 0, 0
        self._last_frame: float | None = None
        self._disk_is_full = False
        self._phase = None if case.phase is None else PhaseRecord(case)
        self.first: State | None = None
        self.first_amount: float | None = None
        self.fatal: tuple[HealthWarning, ...] = ()

    def step(self, record: dict[str, Any], state: State) -> bool:
        """A line of history, rejections counted from the start; whether the run is to end."""
        self._rejected_steps += record["rejected_steps"]
        row = row_of(record | self._extra(state) | {"rejected_steps": self._rejected_steps})
        self._append(row)
        if self._progress is not None:
            self._progress(row)
        # An interrupt ends the run after this step anyway, and is then why it ended.
        if self._case.output.fatal_warnings and not interrupted():
            self.fatal = health_warnings(state.mesh, state.x, state.fields.get("H"))
            self.fatal += self._of_phase(state)
        return bool(self.fatal)

    def _extra(self, state: State) -> dict[str, float]:
        return {} if self._phase is None else self._phase.columns(state)

    def warnings(self, state: State) -> tuple[HealthWarning, ...]:
        """What speaks against a state."""
        found = warnings_of(self._case, state.mesh, state.x, state.fields.get("H"))
        return found + self._of_phase(state)

    def _of_phase(self, state: State) -> tuple[HealthWarning, ...]:
        if self._phase is None:
            return ()
        return warnings_of_phase(self._case, state, self.first_amount)

    def save(self, state: State) -> None:
        """A frame; the first one comes before the first step and starts the history too."""
        if self._last_frame is None:
            self.first = state
            record = first_record(self._flow, state)
            self.first_amount = record.get("phase_amount")
            self._append(row_of(record | self._extra(state)))
        self._last_frame = state.t
        if self._case.output.frames:
            fields = frame_fields(state)
            self._folder.write_frame(state.t, state.mesh, state.x, fields)
            self._frames += 1

    def _append(self, row: dict[str, Any]) -> None:
        self._folder.append_history(row)
        self._rows += 1

    def checkpoint(self, solution: Solution) -> None:
        """What the run goes on from; where it cannot be written, one warning, and the run goes on.

        Of the states that were saved only the first is kept, which pictures show: the others are
        frames.
        """
        remembered = {
            "frames": self._frames,
            "rows": self._rows,
            "rejected_steps": self._rejected_steps,
            "last_frame": self._last_frame,
            "first_amount": self.first_amount,
        }
        first = dataclasses.replace(solution, saved=solution.saved[:1])
        try:
            self._folder.write_checkpoint(first, remembered)
        except OSError as error:
            if not self._disk_is_full:
                words = f"no checkpoint: {error}. The run goes on; later ones are tried, silently."
                warnings.warn(words, UserWarning, stacklevel=2)
            self._disk_is_full = True

    def go_on(self, checkpoint: Checkpoint) -> None:
        """Cut the folder back to a checkpoint, and remember what was known there."""
        known = checkpoint.metadata
        self._rows, self._frames = known["rows"], known["frames"]
        self._rejected_steps, self._last_frame = known["rejected_steps"], known["last_frame"]
        self.first, self.first_amount = checkpoint.solution.saved[0], known["first_amount"]
        self._folder.go_on_from(checkpoint.path)
        self._folder.keep(self._frames, self._rows)

    def finish(self, state: State) -> None:
        """The frame of the last state, unless it has been written."""
        if self._last_frame is None or state.t > self._last_frame:
            self.save(state)


def frame_fields(state: State) -> dict[str, Any]:
    """What a frame shows: H, K, the normal, the velocity, c and μ.

    Velocity and μ are NaN before the first step: all frames of a series have the same fields.
    """
    mesh = state.mesh
    lost = np.full(mesh.n_nodes, np.nan)
    shown = {name: state.fields.get(name, lost) for name in ("c", "mu") if "c" in state.fields}
    if "H" not in state.fields:
        H, nu = recover_mean_curvature(mesh, state.x), recover_normal(mesh, state.x)
        return {"H": H, "K": gaussian_curvature(mesh, state.x, H, nu), "normal": nu} | shown
    velocity = np.asarray(state.fields.get("V", lost))[:, None] * np.asarray(state.nu)
    K = gaussian_curvature(mesh, state.x, state.H, state.nu)
    return {"H": state.H, "K": K, "normal": state.nu, "velocity": velocity} | shown

"""What a branch leaves in its folder while it is followed."""

import time
import warnings
from collections.abc import Iterable
from typing import Any

from .._interrupts import interrupted
from ..cases import Case
from ..equilibria import Branch, Equilibrium
from ..health import HealthWarning, health_warnings
from ..io import BranchCheckpoint, RunFolder
from ._output import fields_of


class BranchRecorder:
    """Keeps every point of a branch, on disk at once."""

    def __init__(self, case: Case, folder: RunFolder, progress, began: float):
        self._case, self._folder, self._progress = case, folder, progress
        self._began, self._disk_is_full = began, False
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

    @property
    def seconds(self) -> float:
        """The time that the branch has taken, that of processes that were stopped included."""
        return time.perf_counter() - self._began

    def checkpoint(self, found: Branch) -> None:
        """What the branch goes on from; where it cannot be written, one warning, and it goes on."""
        try:
            self._folder.write_branch_checkpoint(found, {"wall_seconds": self.seconds})
        except OSError as error:
            if not self._disk_is_full:
                words = f"no checkpoint: {error}. The branch goes on; later ones are tried."
                warnings.warn(words, UserWarning, stacklevel=2)
            self._disk_is_full = True

    def go_on(self, checkpoint: BranchCheckpoint) -> None:
        """Bring the folder back to a checkpoint: its table, and every shape in it."""
        found = checkpoint.branch
        self._began -= float(checkpoint.metadata["wall_seconds"])
        rows = [{"point": number, **row} for number, row in enumerate(found.rows)]
        self._folder.go_on_from(checkpoint.path)
        missing = self._folder.keep_branch(rows)
        for number, (row, shape) in enumerate(zip(rows, found.points, strict=True)):
            fields = fields_of(shape)
            self.points.append(shape)
            self.rows.append(row)
            if number in missing:
                self._folder.write_shape(number, shape.mesh, shape.x, fields)
            self.note(health_warnings(shape.mesh, shape.x, fields["H"]))

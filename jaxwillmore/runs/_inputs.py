"""The files that a case reads, kept beside its results, so that its folder can be moved."""

import dataclasses
import pathlib
import re
from typing import NamedTuple

from ..cases import Case, FitTask, is_example
from ..io import RunFolder

_PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")


class Stored(NamedTuple):
    """A case as it stands in the folder of its run: its text, and the files that the text names.

    Both are in memory before the folder is opened, which may replace the files of the run that the
    case comes from.
    """

    text: str
    files: dict[str, bytes]

    def write(self, folder: RunFolder) -> None:
        """Leave `inputs/` and `case.toml` in a folder."""
        for name, data in self.files.items():
            folder.write_input(name, data)
        folder.write_text("case.toml", self.text)


class _Kept:
    """Files by the name that each gets in `inputs/`: its own where that is plain and free."""

    def __init__(self):
        self.files: dict[str, bytes] = {}
        self._names: dict[str, str] = {}

    def add(self, source: str | None) -> str | None:
        """The name of a file as `case.toml` says it; examples come with the package."""
        if source is None or is_example(source):
            return source
        if source not in self._names:
            path = pathlib.Path(source)
            free = _PLAIN.fullmatch(path.name) and path.name not in self.files
            name = path.name if free else f"input_{len(self.files)}{path.suffix}"
            self._names[source] = name
            self.files[name] = path.read_bytes()
        return f"inputs/{self._names[source]}"


def stored_case(case: Case) -> Stored:
    """What is kept of a case; `OSError` for a file that is gone meanwhile."""
    kept = _Kept()
    surface = dataclasses.replace(case.surface, file=kept.add(case.surface.file))
    phase = case.phase
    if phase is not None:
        phase = dataclasses.replace(phase, file=kept.add(phase.file))
    moved = dataclasses.replace(case, surface=surface, phase=phase)
    return Stored(moved.to_toml(), kept.files)


def stored_fit(task: FitTask) -> Stored:
    """What is kept of the case of a fit."""
    kept = _Kept()
    target = task.target
    files, start = tuple(map(kept.add, target.file)), kept.add(target.start)
    target = dataclasses.replace(target, file=files, start=start)
    return Stored(dataclasses.replace(task, target=target).to_toml(), kept.files)

"""The folder a run leaves behind, complete at every moment."""

import os
import pathlib
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal

from ..equilibria import Branch
from ..evolve import Solution
from ..mesh import SurfaceMesh
from ._atomic import atomic_write, remove_temporaries
from ._checkpoint import (
    BranchCheckpoint,
    Checkpoint,
    previous_generation,
    read_branch_checkpoint,
    read_checkpoint,
    write_branch_checkpoint,
    write_checkpoint,
)
from ._history import History, read_history
from ._links import refuse_link
from ._lock import FolderLock
from ._manifest import Manifest
from ._npz import write_npz
from ._plain import HostNodes, json_text
from ._ply import write_ply
from ._pvd import PvdSeries
from ._table import write_table
from ._vtu import write_vtu

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
_SUBFOLDERS = ("frames", "shapes", "inputs")
# What looks like a file of a run. Only those that the folder lists are ever removed.
_ALIKE = ("frames/frame_*.vtu", "run.pvd", "history.csv", "final.*", "summary.json", "inputs/*")
_ALIKE += ("shapes/shape_*.npz", "branch.csv", "branch.png")
_ALIKE += ("iterate.json", "final_*.npz", "overlay_*.png", "residual_*.png", "profile.png")
CHECKPOINT = "checkpoint.npz"
_ALIKE += ("case.toml", "history.png", CHECKPOINT, previous_generation(CHECKPOINT).name)
# The summary first: without it a folder is no finished run.
_AT_THE_END = ("summary.json", "final.npz", "final.ply", "final.png", "history.png")
_AT_THE_END += ("final.vtu", "branch.png")


class RunFolderError(OSError):
    """A folder cannot take the output of a run."""


class RunFolder:
    """Where a run writes: history, frames, final state, summary.

    ```
    case.toml      history.csv      run.pvd       frames/frame_000000.vtu ...
    final.npz      final.ply        summary.json  checkpoint.npz, checkpoint_previous.npz
    final.vtu      branch.csv       shapes/shape_000000.npz ...     (of equilibria)
    inputs/        .files           (the meshes that a case reads; the names of all files)
    ```

    Every file is either complete or absent, except that `history.csv` grows line by line; so the
    folder of a run that goes on, failed or was killed can be read. No file names a place outside,
    so the folder can be moved. A lock file keeps a second run out; the lock of a killed run is
    recognised and taken over.

    The hidden file `.files` lists what runs wrote here. Only these files are ever replaced. Where
    another file stands that looks like one of a run (`final.docx`), a text of a run that was
    changed since (`case.toml`), or a symbolic link, the folder is refused, naming it. Other files
    stay as they are.

    **Arguments:**

    - `path`: the folder; it is made if its parent exists.
    - `existing`: what to do with an earlier run in it. `"refuse"` it; `"replace"` the files of
        the earlier run, and no others; or `"resume"`: keep its frames and history and add to them
        (call `keep` with what was written before the checkpoint).

    **Raises:** `RunFolderError` when the folder cannot be used, saying why and what to do.

    *Limits:* the folder of a version that did not list its files is refused like any other that
    holds unknown files: move it away, or delete it by hand.

    ```python
    with RunFolder("out") as folder:
        folder.write_frame(0.0, mesh, x, {"H": H})
        folder.append_history({"step": 0, "t": 0.0, "energy": 8 * math.pi})
        folder.write_summary({"status": "reached_t1"})
    ```
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        existing: Literal["refuse", "replace", "resume"] = "refuse",
    ):
        if existing not in ("refuse", "replace", "resume"):
            raise ValueError(f'`existing` is "refuse", "replace" or "resume"; got {existing!r}.')
        if not os.fspath(path):
            raise RunFolderError("the name of the folder is empty; `.` is the current one.")
        self.path = _usable_folder(pathlib.Path(path))
        try:
            self._lock = FolderLock(self.path / ".lock")
        except BlockingIOError as error:
            raise RunFolderError(
                f"`{self.path}` is in use by {error.strerror}; wait for it, or choose another "
                "folder."
            ) from error
        except OSError as error:
            raise RunFolderError(f"cannot write in `{self.path}`: {_words(error)}.") from error
        try:
            self._prepare(existing)
        except BaseException as error:
            self._lock.release()
            if isinstance(error, OSError) and not isinstance(error, RunFolderError):
                raise RunFolderError(f"cannot use `{self.path}`: {_words(error)}.") from error
            raise

    def _prepare(self, existing: str) -> None:
        for name in _SUBFOLDERS:
            refuse_link(self.path / name)
        for place in (self.path, *(self.path / name for name in _SUBFOLDERS)):
            remove_temporaries(place)
        try:
            self._manifest = Manifest(self.path)
        except ValueError as error:
            raise RunFolderError(str(error)) from error
        listed = [name for name in self._manifest.names if os.path.lexists(self.path / name)]
        alike = {
            file.relative_to(self.path).as_posix()
            for pattern in _ALIKE
            for file in self.path.glob(pattern)
        }
        for name in sorted({*alike, *listed}):
            refuse_link(self.path / name)
        unknown = [name for name in sorted({*alike, *listed}) if not self._manifest.knows(name)]
        changed = "case.toml" in unknown and self._manifest.lists("case.toml")
        if existing == "resume" and changed:
            raise RunFolderError(
                f"`{self.path / 'case.toml'}` is not the case that this run began with, and a run "
                "goes on with that. Undo the change, or begin a new run in another folder; a later "
                "`t1` is asked for when the run is resumed."
            )
        if unknown:
            raise RunFolderError(_unknown_words(self.path, unknown))
        if listed and existing == "refuse":
            raise RunFolderError(
                f"`{self.path}` holds an earlier run ({listed[0]}); choose another folder, or "
                "ask to replace it."
            )
        if existing == "replace":
            for name in listed:
                (self.path / name).unlink(missing_ok=True)
            self._manifest.clear()

    def _own(self, name: str, text: str | None = None) -> pathlib.Path:
        """List a file before it is written; a file of somebody else stays."""
        path = self.path / name
        if not self._manifest.lists(name) and os.path.lexists(path):
            raise RunFolderError(_unknown_words(self.path, [name]))
        self._manifest.add(name, text)
        return path

    @property
    def series(self) -> PvdSeries:
        """The list of frames, `run.pvd`."""
        return PvdSeries(self._own("run.pvd"))

    @property
    def history(self) -> History:
        """The table of steps, `history.csv`."""
        return History(self._own("history.csv"))

    @property
    def branch(self) -> History:
        """The table of the points of a branch, `branch.csv`."""
        return History(self._own("branch.csv"))

    def write_checkpoint(self, solution: Solution, metadata: dict[str, Any]) -> None:
        """Write `checkpoint.npz`, after the history before it; see `io.write_checkpoint`."""
        self.history.sync()
        write_checkpoint(self._own_checkpoint(), solution, metadata)

    def write_branch_checkpoint(self, branch: Branch, metadata: dict[str, Any]) -> None:
        """Write `checkpoint.npz` of a branch; see `io.write_branch_checkpoint`."""
        write_branch_checkpoint(self._own_checkpoint(), branch, metadata)

    def _own_checkpoint(self) -> pathlib.Path:
        self._own(previous_generation(CHECKPOINT).name)
        return self._own(CHECKPOINT)

    def read_checkpoint(self, usable: Callable[[Checkpoint], None] | None = None) -> Checkpoint:
        """What `write_checkpoint` wrote; raises and warns as `io.read_checkpoint`."""
        return read_checkpoint(self.path / CHECKPOINT, usable)

    def read_branch_checkpoint(
        self, usable: Callable[[BranchCheckpoint], None] | None = None
    ) -> BranchCheckpoint:
        """What `write_branch_checkpoint` wrote; raises and warns as `io.read_checkpoint`."""
        return read_branch_checkpoint(self.path / CHECKPOINT, usable)

    def go_on_from(self, path: pathlib.Path) -> None:
        """Delete the newest checkpoint where another one is gone on from: it cannot be used.

        The next one would make it the previous one, and for a moment there would be none.
        """
        newest = self.path / CHECKPOINT
        if path != newest:
            newest.unlink(missing_ok=True)

    def drop_previous_checkpoint(self) -> None:
        """Delete the older checkpoint, which a run that has ended needs no more."""
        previous_generation(self.path / CHECKPOINT).unlink(missing_ok=True)

    def file(self, name: str) -> pathlib.Path:
        """The path of a file directly in this folder, which is going to be written.

        **Raises:** `ValueError` unless the name is of letters, digits, `.`, `_`, `-` (at most 64);
        `RunFolderError` where a file stands there that no run wrote.
        """
        return self._own(_checked_name(name))

    def write_text(self, name: str, text: str) -> None:
        """Write a text file, for example `case.toml`."""
        with atomic_write(self._own(_checked_name(name), text), "w") as file:
            file.write(text)

    def write_input(self, name: str, data: bytes) -> None:
        """Write `inputs/NAME`: a file that the case of this run reads."""
        self._subfolder("inputs")
        with atomic_write(self._own(f"inputs/{_checked_name(name)}")) as file:
            file.write(data)

    def append_history(self, row: dict[str, Any]) -> None:
        """Add a line to `history.csv`; see `History.append`."""
        self.history.append(row)

    def write_frame(
        self, t: float, mesh: SurfaceMesh, x: HostNodes, fields: dict[str, Any] | None = None
    ) -> pathlib.Path:
        """Write the next frame and list it in `run.pvd`."""
        entries = self.series.entries()
        number = 1 + max([int(file[-10:-4]) for _, file in entries], default=-1)
        name = f"frames/frame_{number:06d}.vtu"
        self._subfolder("frames")
        write_vtu(self._own(name), mesh, x, fields, time=t)
        self.series.append(t, name)
        return self.path / name

    def write_shape(
        self, number: int, mesh: SurfaceMesh, x: HostNodes, fields: dict[str, Any] | None = None
    ) -> pathlib.Path:
        """Write `shapes/shape_NUMBER.npz`, a point of a branch."""
        self._subfolder("shapes")
        path = self._own(_shape_name(number))
        write_npz(path, mesh, x, fields)
        return path

    def _subfolder(self, name: str) -> None:
        path = self.path / name
        try:
            refuse_link(path)
            path.mkdir(exist_ok=True)
        except OSError as error:
            raise RunFolderError(f"cannot write in `{path}`: {error.strerror}.") from error

    def write_final(
        self, mesh: SurfaceMesh, x: HostNodes, fields: dict[str, Any] | None = None
    ) -> None:
        """Write `final.npz` (all digits, any degree) and `final.ply` (plain fine triangles)."""
        write_npz(self._own("final.npz"), mesh, x, fields)
        write_ply(self._own("final.ply"), mesh, x, fields)

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write `summary.json`; NaN and infinities become `null`."""
        self.write_text("summary.json", json_text(summary))

    def check_kept(self, frames: int, rows: int) -> None:
        """Whether so many frames and rows of history are there.

        **Raises:** `ValueError` saying which are not.
        """
        path = self.path / "history.csv"
        found = len(read_history(path)) if path.exists() else 0
        if found < rows:
            raise ValueError(f"`{path}` holds {found} rows; {rows} were written.")
        names = [name for _, name in PvdSeries(self.path / "run.pvd").entries()] if frames else []
        if len(names) < frames:
            path = self.path / "run.pvd"
            raise ValueError(f"`{path}` lists {len(names)} frames; {frames} were written.")
        lost = [name for name in names[:frames] if not (self.path / name).is_file()]
        if lost:
            raise ValueError(f"`{self.path / lost[0]}` is gone, and the series needs it.")

    def keep(self, frames: int, rows: int) -> None:
        """Forget what came after so many frames and rows of history, and what a run leaves at its
        end, before the run goes on from there.

        **Raises:** `RunFolderError` where the folder holds less than that.
        """
        self._forget(_AT_THE_END)
        try:
            self.history.keep(rows)
            later = self.series.keep(frames) if frames or self._manifest.lists("run.pvd") else []
        except ValueError as error:
            raise RunFolderError(f"`{self.path}` cannot go on: {error}") from error
        self._forget(later)

    def mend_history(self) -> None:
        """Cut off a line of history that a kill left unfinished, which would spoil the next."""
        path = self.path / "history.csv"
        if path.exists():
            self.history.keep(len(read_history(path)))

    def keep_branch(self, rows: Sequence[dict[str, Any]]) -> list[int]:
        """Let the table of a branch have these rows, and forget later shapes and what a branch
        leaves at its end; the numbers of shapes that are missing."""
        self._forget(_AT_THE_END)
        write_table(self._own("branch.csv"), rows)
        known = [_shape_name(number) for number in range(len(rows))]
        found = {f"shapes/{path.name}" for path in (self.path / "shapes").glob("shape_*.npz")}
        self._forget(found.difference(known))
        return [number for number, name in enumerate(known) if name not in found]

    def _forget(self, names: Iterable[str]) -> None:
        for name in names:
            if self._manifest.lists(name):
                (self.path / name).unlink(missing_ok=True)

    def close(self) -> None:
        """Let go of the folder; everything has been written already."""
        self._lock.release()

    def __enter__(self) -> "RunFolder":
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()


def _shape_name(number: int) -> str:
    return f"shapes/shape_{number:06d}.npz"


def _checked_name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError(f"a file of a run is named with A-Z a-z 0-9 . _ -; got {name!r:.80}.")
    return name


def _words(error: OSError) -> str:
    where = "" if error.filename is None else f"`{error.filename}`: "
    return f"{where}{error.strerror or error}"


def _unknown_words(folder: pathlib.Path, names: list[str]) -> str:
    listed = ", ".join(f"`{name}`" for name in names[:10]) + (", ..." if names[10:] else "")
    return (
        f"`{folder}` holds files that no run wrote as they are: {listed}. Nothing was touched. "
        "Move them away or choose another folder; the folder of an older version, which did not "
        "list its files, you may delete by hand."
    )


def _usable_folder(path: pathlib.Path) -> pathlib.Path:
    try:
        if path.exists() and not path.is_dir():
            raise RunFolderError(f"`{path}` is a file; name a folder for the output.")
        path.mkdir(exist_ok=True)
    except FileNotFoundError as error:
        raise RunFolderError(
            f"cannot make the folder `{path}`: its parent `{path.parent}` does not exist; make "
            "that first."
        ) from error
    except RunFolderError:
        raise
    except OSError as error:
        raise RunFolderError(f"cannot make the folder `{path}`: {error.strerror}.") from error
    return path.resolve()

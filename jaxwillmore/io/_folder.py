"""The folder a run leaves behind, complete at every moment."""

import os
import pathlib
import re
from typing import Any, Literal

from ..mesh import SurfaceMesh
from ._atomic import atomic_write, remove_temporaries
from ._history import History
from ._lock import FolderLock
from ._npz import write_npz
from ._plain import HostNodes, write_json
from ._ply import write_ply
from ._pvd import PvdSeries
from ._vtu import write_vtu

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
_OURS = ("frames/frame_*.vtu", "run.pvd", "history.csv", "final.*", "summary.json")
_OURS += ("shapes/shape_*.npz", "branch.csv", "branch.png")
_OURS += ("iterate.json", "final_*.npz", "overlay_*.png", "residual_*.png", "profile.png")
_OURS += ("case.toml", "history.png", "checkpoint.npz", "checkpoint_previous.npz")


class RunFolderError(OSError):
    """A folder cannot take the output of a run."""


class RunFolder:
    """Where a run writes: history, frames, final state, summary.

    ```
    case.toml      history.csv      run.pvd       frames/frame_000000.vtu ...
    final.npz      final.ply        summary.json  checkpoint.npz
    final.vtu      branch.csv       shapes/shape_000000.npz ...     (of equilibria)
    ```

    Every file is either complete or absent, except that `history.csv` grows line by line; so the
    folder of a run that goes on, failed or was killed can be read. A lock file keeps a second run
    out; the lock of a killed run is recognised and taken over.

    **Arguments:**

    - `path`: the folder; it is made if its parent exists.
    - `existing`: what to do with an earlier run in it. `"refuse"` it; `"replace"` the files of
        the earlier run, and no others; or `"resume"`: keep its frames and history and add to them
        (call `keep_until` with the time of the checkpoint).

    **Raises:** `RunFolderError` when the folder cannot be used, saying why and what to do.

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
        self.path = _usable_folder(pathlib.Path(path))
        try:
            self._lock = FolderLock(self.path / ".lock")
        except BlockingIOError as error:
            raise RunFolderError(
                f"`{self.path}` is in use by {error.strerror}; wait for it, or choose another "
                "folder."
            ) from error
        except OSError as error:
            raise RunFolderError(f"cannot write in `{self.path}`: {error.strerror}.") from error
        try:
            self._prepare(existing)
        except BaseException:
            self._lock.release()
            raise

    def _prepare(self, existing: str) -> None:
        remove_temporaries(self.path)
        ours = [file for pattern in _OURS for file in self.path.glob(pattern)]
        if ours and existing == "refuse":
            raise RunFolderError(
                f"`{self.path}` holds an earlier run ({ours[0].name}); choose another folder, or "
                "ask to replace it."
            )
        if existing == "replace":
            for file in ours:
                file.unlink()
        for name in ("frames", "shapes"):
            remove_temporaries(self.path / name)

    @property
    def series(self) -> PvdSeries:
        """The list of frames, `run.pvd`."""
        return PvdSeries(self.path / "run.pvd")

    @property
    def history(self) -> History:
        """The table of steps, `history.csv`."""
        return History(self.path / "history.csv")

    @property
    def branch(self) -> History:
        """The table of the points of a branch, `branch.csv`."""
        return History(self.path / "branch.csv")

    @property
    def checkpoint(self) -> pathlib.Path:
        """Where this run's checkpoint belongs."""
        return self.path / "checkpoint.npz"

    def file(self, name: str) -> pathlib.Path:
        """The path of a file directly in this folder.

        **Raises:** `ValueError` unless the name is of letters, digits, `.`, `_`, `-` (at most 64).
        """
        if not _NAME.fullmatch(name):
            raise ValueError(f"a file of a run is named with A-Z a-z 0-9 . _ -; got {name!r:.80}.")
        return self.path / name

    def write_text(self, name: str, text: str) -> None:
        """Write a text file, for example `case.toml`."""
        with atomic_write(self.file(name), "w") as file:
            file.write(text)

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
        write_vtu(self.path / name, mesh, x, fields, time=t)
        self.series.append(t, name)
        return self.path / name

    def write_shape(
        self, number: int, mesh: SurfaceMesh, x: HostNodes, fields: dict[str, Any] | None = None
    ) -> pathlib.Path:
        """Write `shapes/shape_NUMBER.npz`, a point of a branch."""
        path = self._subfolder("shapes") / f"shape_{number:06d}.npz"
        write_npz(path, mesh, x, fields)
        return path

    def _subfolder(self, name: str) -> pathlib.Path:
        path = self.path / name
        try:
            path.mkdir(exist_ok=True)
        except OSError as error:
            raise RunFolderError(f"cannot write in `{path}`: {error.strerror}.") from error
        return path

    def write_final(
        self, mesh: SurfaceMesh, x: HostNodes, fields: dict[str, Any] | None = None
    ) -> None:
        """Write `final.npz` (all digits, any degree) and `final.ply` (plain fine triangles)."""
        write_npz(self.path / "final.npz", mesh, x, fields)
        write_ply(self.path / "final.ply", mesh, x, fields)

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write `summary.json`; NaN and infinities become `null`."""
        write_json(self.path / "summary.json", summary)

    def keep_until(self, t: float) -> None:
        """Forget frames and history after `t`, before a run resumes from there."""
        self.series.keep_until(t)
        self.history.keep_until(t)

    def close(self) -> None:
        """Let go of the folder; everything has been written already."""
        self._lock.release()

    def __enter__(self) -> "RunFolder":
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()


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

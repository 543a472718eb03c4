"""What a run or a branch goes on from, in two generations."""

import os
import pathlib
import warnings
from collections.abc import Callable
from typing import IO, Any, NamedTuple

from ..equilibria import Branch
from ..evolve import Solution
from ._atomic import TEMPORARY, atomic_write
from ._branch import save_branch, stored_branch
from ._computer import differences
from ._sealed import MAX_BYTES, SolutionError
from ._solution import save_solution, stored_solution


class CheckpointWarning(UserWarning):
    """The newest checkpoint cannot be used, and the one before it is."""


class Checkpoint(NamedTuple):
    """What `read_checkpoint` returns.

    **Attributes:**

    - `solution`: for `evolve(..., resume=solution)`.
    - `metadata`: what was written beside it.
    - `notes`: why the run that goes on may differ in the last digits; empty where it does not.
    - `path`: the file that it was read from.
    """

    solution: Solution
    metadata: dict[str, Any]
    notes: tuple[str, ...]
    path: pathlib.Path


class BranchCheckpoint(NamedTuple):
    """What `read_branch_checkpoint` returns: as `Checkpoint`, for `branch(..., resume=branch)`."""

    branch: Branch
    metadata: dict[str, Any]
    notes: tuple[str, ...]
    path: pathlib.Path


def previous_generation(path: str | os.PathLike[str]) -> pathlib.Path:
    """Where `write_checkpoint` keeps the checkpoint before the last one."""
    path = pathlib.Path(path)
    return path.with_name(f"{path.stem}_previous{path.suffix}")


def write_checkpoint(
    path: str | os.PathLike[str], solution: Solution, metadata: dict[str, Any] | None = None
) -> None:
    """Write a run as `write_solution` does, and keep what was there as `previous_generation(path)`.

    At every moment, and after every failure, one of the two is complete.

    **Arguments:**

    - `metadata`: anything JSON can say.
    """
    _write(path, lambda file: save_solution(file, solution, metadata or {}))


def write_branch_checkpoint(
    path: str | os.PathLike[str], branch: Branch, metadata: dict[str, Any] | None = None
) -> None:
    """Write a branch as `write_branch` does, in two generations as `write_checkpoint`."""
    _write(path, lambda file: save_branch(file, branch, metadata or {}))


def _write(path: str | os.PathLike[str], save: Callable[[IO[bytes]], None]) -> None:
    path = pathlib.Path(path)
    with atomic_write(path) as file:
        save(file)
        # The new one is on the disk before the oldest leaves it.
        file.flush()
        os.fsync(file.fileno())
        _rotate(path)


def _rotate(path: pathlib.Path) -> None:
    """Give the file at `path` a second name, so that no moment is without a checkpoint."""
    if not path.exists():
        return
    second = path.with_name(f"{TEMPORARY}{os.getpid()}-previous.tmp")
    second.unlink(missing_ok=True)
    try:
        os.link(path, second)
    except OSError:  # a file system without hard links
        os.replace(path, previous_generation(path))
    else:
        os.replace(second, previous_generation(path))


def read_checkpoint(
    path: str | os.PathLike[str], usable: Callable[[Checkpoint], None] | None = None
) -> Checkpoint:
    """The newest checkpoint that can be used, which may be the previous one.

    **Arguments:**

    - `usable`: raises `ValueError` for a checkpoint that does not fit what is beside it.

    **Raises:** `SolutionError` where neither can be used, saying why; `FileNotFoundError` where
    there is none. Warns with `CheckpointWarning` where it is the previous one.
    """

    def read(path: pathlib.Path) -> Checkpoint:
        stored = stored_solution(path, MAX_BYTES)
        notes = _notes("run", stored.computer)
        found = Checkpoint(stored.content, stored.metadata, notes, path)
        _check(path, found, usable)
        return found

    return _newest(pathlib.Path(path), "run", read)


def read_branch_checkpoint(
    path: str | os.PathLike[str], usable: Callable[[BranchCheckpoint], None] | None = None
) -> BranchCheckpoint:
    """As `read_checkpoint`, of a branch."""

    def read(path: pathlib.Path) -> BranchCheckpoint:
        stored = stored_branch(path, MAX_BYTES)
        notes = _notes("branch", stored.computer)
        found = BranchCheckpoint(stored.content, stored.metadata, notes, path)
        _check(path, found, usable)
        return found

    return _newest(pathlib.Path(path), "branch", read)


def _newest(path: pathlib.Path, what: str, read: Callable[[pathlib.Path], Any]) -> Any:
    try:
        return read(path)
    except (SolutionError, FileNotFoundError) as error:
        previous = previous_generation(path)
        if not previous.exists():
            raise
        why = str(error)
        try:
            found = read(previous)
        except SolutionError as other:
            raise SolutionError(f"{why} The checkpoint before it: {other}") from other
    warnings.warn(
        f"{why.removesuffix('.')}; the {what} goes on from `{previous.name}`.",
        CheckpointWarning,
        stacklevel=3,
    )
    return found


def _check(path: pathlib.Path, found: Any, usable: Callable[[Any], None] | None) -> None:
    if usable is None:
        return
    try:
        usable(found)
    except ValueError as error:
        raise SolutionError(f"`{path}` cannot be used: {error}") from error


def _notes(what: str, before: dict[str, Any]) -> tuple[str, ...]:
    changed = differences(before)
    if not changed:
        return ()
    return (
        f"the {what} was begun elsewhere ({', '.join(changed)}): it goes on equal to tolerance, "
        "not to the last bit",
    )

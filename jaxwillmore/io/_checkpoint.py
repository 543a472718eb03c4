"""What a run goes on from, in two generations."""

import os
import pathlib
import warnings
from typing import Any, NamedTuple

from ..evolve import Solution
from ._atomic import TEMPORARY, atomic_write
from ._computer import differences
from ._solution import SolutionError, save_solution, stored_solution


class CheckpointWarning(UserWarning):
    """The newest checkpoint cannot be used, and the one before it is."""


class Checkpoint(NamedTuple):
    """What `read_checkpoint` returns.

    **Attributes:**

    - `solution`: for `evolve(..., resume=solution)`.
    - `metadata`: what was written beside it.
    - `notes`: why the run that goes on may differ in the last digits; empty where it does not.
    """

    solution: Solution
    metadata: dict[str, Any]
    notes: tuple[str, ...]


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
    path = pathlib.Path(path)
    with atomic_write(path) as file:
        save_solution(file, solution, metadata or {})
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


def read_checkpoint(path: str | os.PathLike[str]) -> Checkpoint:
    """The newest checkpoint that is whole, which is the previous one where the newest is damaged.

    **Raises:** `SolutionError` where both are damaged; `FileNotFoundError` where there is none.
    Warns with `CheckpointWarning` where the newest cannot be used.
    """
    path = pathlib.Path(path)
    try:
        stored = stored_solution(path)
    except (SolutionError, FileNotFoundError) as error:
        previous = previous_generation(path)
        if not previous.exists():
            raise
        warnings.warn(
            f"{str(error).removesuffix('.')}; the run goes on from `{previous.name}`.",
            CheckpointWarning,
            stacklevel=2,
        )
        stored = stored_solution(previous)
    changed = differences(stored.computer)
    notes = ()
    if changed:
        notes = (
            f"the run was begun elsewhere ({', '.join(changed)}): it goes on equal to tolerance, "
            "not to the last bit",
        )
    return Checkpoint(stored.solution, stored.metadata, notes)

"""Runs in files."""

import os
from typing import IO, Any, NamedTuple

from ..evolve import Solution, parts_of, solution_of
from ._atomic import atomic_write
from ._sealed import MAX_BYTES, WRONG, Kind, SolutionError

RUN = Kind("jaxwillmore run", "run", 1)


class Stored(NamedTuple):
    """What a file of a run holds."""

    solution: Solution
    metadata: dict[str, Any]
    computer: dict[str, Any]


def write_solution(path: str | os.PathLike[str], solution: Solution) -> None:
    """Write a run to an NPZ file, atomically and with a checksum; nothing is pickled.

    Every digit comes back, and with them all that `evolve(..., resume=...)` needs to go on to the
    last bit, on the same machine with the same versions.

    ```python
    jw.io.write_solution("run.npz", solution)
    solution = jw.io.read_solution("run.npz")
    solution = jw.evolve.evolve(flow, mesh, x0, t1=2.0, resume=solution)
    ```
    """
    with atomic_write(path) as file:
        save_solution(file, solution, {})


def read_solution(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> Solution:
    """The run in a file of `write_solution` or `write_checkpoint`.

    **Arguments:**

    - `max_bytes`: refuse files that unpack to more.

    **Raises:** `SolutionError` for a file that is truncated, damaged, of another format, or
    something else, and for one whose parts do not fit together; `FileNotFoundError`.
    """
    return stored_solution(path, max_bytes).solution


def save_solution(file: IO[bytes], solution: Solution, metadata: dict[str, Any]) -> None:
    """Write a run to a file that is open."""
    RUN.save(file, *parts_of(solution), metadata)


def stored_solution(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> Stored:
    """A run with what was written beside it; raises as `read_solution`."""
    content = RUN.content(path, max_bytes)
    try:
        solution = solution_of(content.words, content.arrays)
    except WRONG as error:
        words = RUN.not_whole(error, content.computer)
        raise SolutionError(f"`{os.fspath(path)}` {words}") from error
    return Stored(solution, content.metadata, content.computer)

"""Runs in files."""

import os
from typing import IO, Any

from ..evolve import Solution, parts_of, solution_of
from ._atomic import atomic_write
from ._sealed import MAX_BYTES, Kind, Stored

RUN = Kind("jaxwillmore run", "run", 1)


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
    return stored_solution(path, max_bytes).content


def save_solution(file: IO[bytes], solution: Solution, metadata: dict[str, Any]) -> None:
    """Write a run to a file that is open."""
    RUN.save(file, *parts_of(solution), metadata)


def stored_solution(path: str | os.PathLike[str], max_bytes: int) -> Stored:
    """A run with what was written beside it; raises as `read_solution`."""
    return RUN.read(path, max_bytes, solution_of)

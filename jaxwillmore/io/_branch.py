"""Branches of equilibria in files."""

import os
from typing import IO, Any

from ..equilibria import Branch, branch_of, parts_of
from ._atomic import atomic_write
from ._sealed import MAX_BYTES, Kind, Stored

BRANCH = Kind("jaxwillmore branch", "branch", 1)


def write_branch(path: str | os.PathLike[str], branch: Branch) -> None:
    """Write a branch to an NPZ file, atomically and with a checksum; nothing is pickled.

    Every digit of its points, table and events comes back, and with them all that
    `branch(..., resume=...)` needs to go on to the last bit, on the same machine with the same
    versions.

    **Raises:** `TypeError` for an energy that holds a function of the user, or is not of this
    package.

    ```python
    jw.io.write_branch("discs.npz", found)
    found = jw.io.read_branch("discs.npz")
    further = jw.equilibria.branch(found.points[-1], stop=0.5)
    crossing = jw.equilibria.switch(found.events[0])
    ```
    """
    with atomic_write(path) as file:
        save_branch(file, branch, {})


def read_branch(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> Branch:
    """The branch in a file of `write_branch`, or in the checkpoint of `jaxwillmore branch`.

    **Arguments:**

    - `max_bytes`: refuse files that unpack to more.

    **Raises:** `SolutionError` for a file that is truncated, damaged, of another format, or
    something else, and for one whose parts do not fit together; `FileNotFoundError`.
    """
    return stored_branch(path, max_bytes).content


def save_branch(file: IO[bytes], branch: Branch, metadata: dict[str, Any]) -> None:
    """Write a branch to a file that is open."""
    BRANCH.save(file, *parts_of(branch), metadata)


def stored_branch(path: str | os.PathLike[str], max_bytes: int) -> Stored:
    """A branch with what was written beside it; raises as `read_branch`."""
    return BRANCH.read(path, max_bytes, branch_of)

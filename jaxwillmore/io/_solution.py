"""Runs in files, and the refusal to load anything that is not exactly one."""

import hashlib
import json
import os
import pathlib
from typing import IO, Any, NamedTuple

import numpy as np

from ..evolve import Solution, parts_of, solution_of
from ._atomic import atomic_write
from ._computer import computer
from ._npz import NpzError, read_npz, save_arrays
from ._plain import plain

FORMAT = "jaxwillmore run"
VERSION = 1
MAX_BYTES = 2**34


class SolutionError(ValueError):
    """A file is no run, or is damaged."""


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
    something else; `FileNotFoundError`.
    """
    return stored_solution(path, max_bytes).solution


def save_solution(file: IO[bytes], solution: Solution, metadata: dict[str, Any]) -> None:
    """Write a run to a file that is open."""
    words, arrays = parts_of(solution)
    arrays = {name: _little_endian(array) for name, array in arrays.items()}
    header = {
        "format": FORMAT,
        "format_version": VERSION,
        "computer": computer(),
        "metadata": metadata,
        "run": words,
        # Members of the archive have plain names, whatever a field is called.
        "arrays": list(arrays),
    }
    text = json.dumps(plain(header)).encode()
    members = {f"array_{number:06d}": array for number, array in enumerate(arrays.values())}
    own = {
        "header": np.frombuffer(text, np.uint8),
        "sha256": _digest(text, list(arrays.values())),
    }
    save_arrays(file, own | members)


def stored_solution(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> Stored:
    """A run with what was written beside it; raises as `read_solution`."""
    path = pathlib.Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no file `{path}`.")
    with open(path, "rb") as file:
        try:
            members = read_npz(file, max_bytes=max_bytes, max_members=10**6)
        except NpzError as error:
            raise SolutionError(f"`{path}` is no whole run: {error}.") from error
    header, text, sha256 = _header(path, members)
    arrays = [members[name] for name in sorted(members)]
    if not np.array_equal(sha256, _digest(text, arrays)):
        raise SolutionError(f"`{path}` is damaged: its checksum does not fit its content.")
    try:
        named = dict(zip(header["arrays"], arrays, strict=True))
        solution = solution_of(header["run"], named)
        return Stored(solution, dict(header["metadata"]), dict(header["computer"]))
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise SolutionError(f"`{path}` does not hold the parts of a run: {error!r}.") from error


def _header(path: pathlib.Path, members: dict[str, np.ndarray]) -> tuple[dict, bytes, np.ndarray]:
    """The header, its text and the checksum, which leave `members`."""
    problem = f"`{path}` was not written by this package."
    try:
        text = members.pop("header").tobytes()
        sha256 = members.pop("sha256")
        header = json.loads(text)
        ours, version = header["format"] == FORMAT, header["format_version"]
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise SolutionError(problem) from error
    if not ours:
        raise SolutionError(problem)
    if version != VERSION:
        wrote = header.get("computer", {}).get("jaxwillmore", "?")
        raise SolutionError(
            f"`{path}` has format {version}, written by jaxwillmore {wrote}; this one reads "
            f"format {VERSION}. Use the version that wrote it."
        )
    return header, text, sha256


def _little_endian(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "biuf":
        raise TypeError(f"a run holds numbers; got an array of {array.dtype}.")
    # Not `ascontiguousarray` alone, which makes a number a vector.
    order = array.dtype.newbyteorder("<")
    return np.ascontiguousarray(array, order).reshape(array.shape)


def _digest(header: bytes, arrays: list[np.ndarray]) -> np.ndarray:
    sha = hashlib.sha256(header)
    for array in arrays:
        sha.update(str((array.dtype.str, array.shape)).encode())
        sha.update(array.tobytes())
    return np.frombuffer(sha.digest(), np.uint8)

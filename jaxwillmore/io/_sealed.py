"""Words and arrays in one file with a checksum, and the refusal to load anything else."""

import dataclasses
import hashlib
import json
import os
import pathlib
from collections.abc import Callable
from typing import IO, Any, NamedTuple

import numpy as np

from .._version import __version__
from ._computer import computer
from ._npz import NpzError, read_npz, save_arrays
from ._plain import plain

MAX_BYTES = 2**34
# What a reader may meet in words that are not what they should be.
WRONG = (LookupError, TypeError, ValueError, AttributeError, OverflowError)
_FORMATS = {"jaxwillmore run": "a run", "jaxwillmore branch": "a branch"}


class SolutionError(ValueError):
    """A file is no run or branch, or is damaged."""


class Stored(NamedTuple):
    """What a file holds, and what was written beside it."""

    content: Any
    metadata: dict[str, Any]
    computer: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of file.

    - `format`: what the file says that it is.
    - `key`: where its words stand in the header.
    - `version`: of the format; files of another one are refused.
    """

    format: str
    key: str
    version: int

    @property
    def words(self) -> str:
        """What is in it, with an article."""
        return _FORMATS[self.format]

    def save(
        self,
        file: IO[bytes],
        words: dict[str, Any],
        arrays: dict[str, np.ndarray],
        metadata: dict[str, Any],
    ) -> None:
        """Write to a file that is open."""
        arrays = {name: _little_endian(array) for name, array in arrays.items()}
        header = {
            "format": self.format,
            "format_version": self.version,
            "computer": computer(),
            "metadata": metadata,
            self.key: words,
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

    def read(
        self,
        path: str | os.PathLike[str],
        max_bytes: int,
        made_of: Callable[[dict[str, Any], dict[str, np.ndarray]], Any],
    ) -> Stored:
        """What `made_of` makes of the words and arrays that `save` was given, every bit of them.

        **Raises:** `SolutionError` for a file that is truncated, damaged, of another kind or
        version, or something else, and for parts that do not fit together; `FileNotFoundError`.
        """
        path = pathlib.Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"there is no file `{path}`.")
        with open(path, "rb") as file:
            try:
                members = read_npz(file, max_bytes=max_bytes, max_members=10**6)
            except NpzError as error:
                raise SolutionError(f"`{path}` is no whole {self.key}: {error}.") from error
        header, text, sha256 = self._header(path, members)
        arrays = [members[name] for name in sorted(members)]
        if not np.array_equal(sha256, _digest(text, arrays)):
            raise SolutionError(f"`{path}` is damaged: its checksum does not fit its content.")
        try:
            named = dict(zip(header["arrays"], arrays, strict=True))
            parts = (header[self.key], header["metadata"], header["computer"])
            words, metadata, where = map(dict, parts)
        except WRONG as error:
            raise SolutionError(f"`{path}` {self._not_whole(error, {})}") from error
        try:
            return Stored(made_of(words, named), metadata, where)
        except WRONG as error:
            raise SolutionError(f"`{path}` {self._not_whole(error, where)}") from error

    def _not_whole(self, error: Exception, where: dict[str, Any]) -> str:
        """Why a file with a good checksum is refused all the same, and what to do."""
        wrote = where.get("jaxwillmore", __version__)
        who = "" if wrote == __version__ else f" It was written by jaxwillmore {wrote}: use that."
        missing = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        return f"does not hold the parts of {self.words}: {missing.removesuffix('.')}.{who}"

    def _header(self, path: pathlib.Path, members: dict[str, np.ndarray]):
        """The header, its text and the checksum, which leave `members`."""
        problem = f"`{path}` was not written by this package."
        try:
            text = members.pop("header").tobytes()
            sha256 = members.pop("sha256")
            header = json.loads(text)
            format, version = header["format"], header["format_version"]
        except (KeyError, ValueError, TypeError, RecursionError) as error:
            raise SolutionError(problem) from error
        if format != self.format:
            if format in _FORMATS:
                problem = f"`{path}` holds {_FORMATS[format]}, not {self.words}."
            raise SolutionError(problem)
        if version != self.version:
            wrote = header.get("computer", {}).get("jaxwillmore", "?")
            raise SolutionError(
                f"`{path}` has format {version}, written by jaxwillmore {wrote}; this one reads "
                f"format {self.version}. Use the version that wrote it."
            )
        return header, text, sha256


def _little_endian(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "biuf":
        raise TypeError(f"a file of this kind holds numbers; got an array of {array.dtype}.")
    # Not `ascontiguousarray` alone, which makes a number a vector.
    order = array.dtype.newbyteorder("<")
    return np.ascontiguousarray(array, order).reshape(array.shape)


def _digest(header: bytes, arrays: list[np.ndarray]) -> np.ndarray:
    sha = hashlib.sha256(header)
    for array in arrays:
        sha.update(str((array.dtype.str, array.shape)).encode())
        sha.update(array.tobytes())
    return np.frombuffer(sha.digest(), np.uint8)

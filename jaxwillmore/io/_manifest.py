"""The list of the files that runs wrote in a folder."""

import hashlib
import os
import pathlib
import re

from ._atomic import atomic_write
from ._links import unlinked

MANIFEST = ".files"
_HEAD = "# Files that runs of jaxwillmore wrote here. A run that replaces them removes no others.\n"
_LINE = re.compile(
    r"(?P<name>(?:(?:frames|shapes|inputs)/)?[A-Za-z0-9_][A-Za-z0-9._-]{0,63})"
    r"(?: sha256=(?P<digest>[0-9a-f]{64}))?"
)
_MAX_BYTES = 2**28


class Manifest:
    """The names in `.files`, one a line, and of texts what they contain.

    A name is on the disk before its file is, so every file of a run that was killed is known. A
    text that a person changed since is no longer the one that was written.

    **Raises:** `ValueError` where `.files` is something else; `OSError` where it is a symbolic
    link or cannot be read.
    """

    def __init__(self, folder: pathlib.Path):
        self._folder = folder
        self._digests: dict[str, set[str]] = {}
        self._read()

    @property
    def names(self) -> list[str]:
        """All names, `summary.json` first: without it a folder is no finished run."""
        return sorted(self._digests, key=lambda name: (name != "summary.json", name))

    def _read(self) -> None:
        path = self._folder / MANIFEST
        try:
            with open(path, "rb", opener=unlinked) as file:
                data = file.read(_MAX_BYTES + 1)
        except FileNotFoundError:
            return
        problem = f"`{path}` is not a list of the files of a run; move it away."
        if len(data) > _MAX_BYTES:
            raise ValueError(problem)
        # A kill may cut the last line short; its file was not begun then.
        whole = data[: data.rfind(b"\n") + 1]
        for line in whole.decode("utf-8", "replace").splitlines():
            if line.startswith("#"):
                continue
            found = _LINE.fullmatch(line)
            if found is None:
                raise ValueError(problem)
            self._note(found["name"], found["digest"])
        if whole != data:
            with atomic_write(path) as file:
                file.write(whole)

    def _note(self, name: str, digest: str | None) -> None:
        digests = self._digests.setdefault(name, set())
        if digest:
            digests.add(digest)

    def add(self, name: str, text: str | None = None) -> None:
        """List a file, and what a text will contain."""
        digest = None if text is None else _digest(text.encode())
        if name in self._digests and (digest is None or digest in self._digests[name]):
            return
        path = self._folder / MANIFEST
        line = name if digest is None else f"{name} sha256={digest}"
        with open(path, "a", encoding="utf-8", newline="", opener=unlinked) as file:
            file.write(f"{line}\n" if file.tell() else f"{_HEAD}{line}\n")
            file.flush()
            os.fsync(file.fileno())
        self._note(name, digest)

    def knows(self, name: str) -> bool:
        """Whether a file, which is there, is listed, and a text still the one that was written."""
        if name not in self._digests:
            return False
        digests = self._digests[name]
        return not digests or _digest((self._folder / name).read_bytes()) in digests

    def lists(self, name: str) -> bool:
        """Whether the name is listed, whatever stands there now."""
        return name in self._digests

    def clear(self) -> None:
        """Forget everything, when the files are gone."""
        self._digests = {}
        with atomic_write(self._folder / MANIFEST, "w") as file:
            file.write(_HEAD)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()

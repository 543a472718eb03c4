"""From a name to bytes of a known format: existence, size, extension, first bytes."""

import difflib
import os
import pathlib

from ..mesh import SurfaceError
from ._off import begins_off
from ._words import without_mark

FORMATS = ("ply", "off", "obj", "stl", "npz", "vtu")


def _sniff(data: bytes) -> str | None:
    """The format the first bytes speak of, if they do."""
    head = without_mark(data[:4096])
    if head.startswith(b"ply") and head[3:4].isspace():
        return "ply"
    if head.lstrip().startswith((b"<?xml", b"<VTKFile")) and b"<VTKFile" in head:
        return "vtu"
    if head.startswith(b"PK\x03\x04"):
        return "npz"
    if len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        return "stl"
    if head.lstrip().lower().startswith(b"solid") and b"facet" in head.lower():
        return "stl"
    lines = [line.split() for line in head.splitlines()]
    first = [words[0] for words in lines if words and not words[0].startswith(b"#")]
    if first and begins_off(first[0].decode("latin-1")):
        return "off"
    if b"v" in first[:50] and b"\0" not in head:
        return "obj"
    return None


def read_bytes(path: str | os.PathLike[str], max_bytes: int) -> tuple[str, bytes]:
    """The format and the content of a file of a surface.

    **Raises:** `FileNotFoundError`, `IsADirectoryError`, or `SurfaceError` when the file is too
    large, of an unknown kind, or not of the kind its name says.
    """
    path = pathlib.Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"`{path}` is a folder; name the file of the surface in it.")
    if not path.exists():
        if path.is_symlink():
            raise FileNotFoundError(f"`{path}` is a symbolic link that leads nowhere.")
        near = difflib.get_close_matches(path.name, _names_in(path.parent), n=1)
        hint = f" Did you mean `{path.parent / near[0]}`?" if near else ""
        raise FileNotFoundError(
            f"there is no file `{path}` (seen from `{pathlib.Path.cwd()}`).{hint}"
        )
    if not path.is_file():
        raise SurfaceError(f"`{path}` is not a regular file.")
    format = path.suffix.lower().removeprefix(".")
    known = ", ".join(f".{known}" for known in FORMATS)
    if format not in FORMATS:
        raise SurfaceError(f"`{path}`: surfaces are read from {known}; got {path.suffix!r}.")
    size = path.stat().st_size
    if size > max_bytes:
        raise SurfaceError(
            f"`{path}` has {size} bytes; at most {max_bytes} are read. Raise `max_bytes` if the "
            "file is what you think it is."
        )
    if size == 0:
        raise SurfaceError(f"`{path}` is empty: 0 bytes.")
    data = path.read_bytes()
    found = _sniff(data)
    if found not in (None, format):
        raise SurfaceError(
            f"`{path}` holds a surface in the format {found.upper()}, not {format.upper()}; rename "
            f"it to `{path.with_suffix('.' + found).name}`."
        )
    return format, data


def _names_in(folder: pathlib.Path) -> list[str]:
    return [entry.name for entry in folder.iterdir()] if folder.is_dir() else []

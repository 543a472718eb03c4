"""The header of a PLY file: which elements of how many numbers follow, and where."""

import re
from typing import NamedTuple

from ..mesh import SurfaceError
from ._words import count

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_WHOLE = {word for word, type in _TYPES.items() if type[0] != "f"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER = 2**16
_END = re.compile(rb"[\r\n][ \t]*end_header[ \t]*(\r\n|\r|\n)")
CORNERS = ("vertex_index", "vertex_indices")


class Property(NamedTuple):
    """A number, or a list of numbers, of every entry of an element."""

    name: str
    type: str
    count_type: str | None  # None for a single number


class Element(NamedTuple):
    """So many entries with the same properties."""

    name: str
    length: int
    properties: list[Property]


class Header(NamedTuple):
    """What a header says about the body."""

    order: str
    """Byte order, or nothing for text."""
    elements: list[Element]
    start: int
    """Where the body begins."""
    line: int
    """In which line."""


def read_header(name: str, data: bytes) -> Header:
    """The header, with elements up to vertices and faces only.

    **Raises:** `SurfaceError` where it is no header, or speaks of something that cannot be read.
    """
    end = _END.search(data, 0, _MAX_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise SurfaceError(
            f"{name}: not a PLY file, or truncated: its header does not end with a line "
            "`end_header`."
        )
    lines = data[: end.start()].decode("utf-8", errors="replace").splitlines()
    order, elements = None, []
    for number, line in enumerate(lines[1:], start=2):
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", word, "1.0"] if word in _ORDERS:
                order = _ORDERS[word]
            case ["element", word, length]:
                elements.append(Element(word, count(name, number, length, word), []))
            case ["property", "list", size, type, word] if (
                elements and size in _TYPES and type in _TYPES
            ):
                if size not in _WHOLE:
                    raise SurfaceError(
                        f"{name}, line {number}: the length of the list {word[:40]!r} is declared "
                        f"as {size!r}; it must be a type of whole numbers."
                    )
                elements[-1].properties.append(Property(word, _TYPES[type], _TYPES[size]))
            case ["property", type, word] if elements and type in _TYPES:
                elements[-1].properties.append(Property(word, _TYPES[type], None))
            case _:
                raise SurfaceError(f"{name}, line {number}: not a PLY header: {line[:80]!r}.")
    if order is None:
        raise SurfaceError(f"{name}: the PLY header does not name a format that can be read.")
    # a line feed belongs to the body where lines of the header end with a carriage return alone
    feed = end.group(1) == b"\r\n" and not re.match(rb"ply[ \t]*\r\n", data)
    start = end.end() - feed
    return Header(order, _checked(name, elements, len(data) - start), start, len(lines) + 2)


def _checked(name: str, elements: list[Element], n_bytes: int) -> list[Element]:
    """The elements up to the faces, or a complaint about what is missing."""
    kinds = [element.name for element in elements]
    if kinds.count("vertex") != 1 or kinds.count("face") != 1:
        shown = ", ".join(kinds)[:80] or "nothing"
        raise SurfaceError(
            f"{name}: the PLY file needs one list of vertices and one of faces; its elements: "
            f"{shown}."
        )
    elements = elements[: max(kinds.index("vertex"), kinds.index("face")) + 1]
    for element in elements:
        if element.length > n_bytes:  # every entry takes at least one byte
            raise SurfaceError(
                f"{name}: the header announces {element.length} entries of {element.name[:40]!r} "
                f"in a file of {n_bytes} bytes; it is damaged."
            )
        names = [p.name for p in element.properties]
        if len(set(names)) < len(names):
            raise SurfaceError(f"{name}: the element {element.name[:40]!r} has a property twice.")
        listed = {p.name for p in element.properties if p.count_type}
        if element.name == "face" and len(set(CORNERS) & listed) != 1:
            raise SurfaceError(f"{name}: the faces have no list named `vertex_indices`.")
        if element.name == "vertex":
            missing = {"x", "y", "z"} - (set(names) - listed)
            if missing:
                raise SurfaceError(f"{name}: the vertices have no number {sorted(missing)}.")
    return elements

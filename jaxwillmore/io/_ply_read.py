"""PLY files, text and binary, read into vertices and faces.

Read here and not by trimesh, which cuts off faces of a truncated text file, drops the fraction of
a vertex number, and reads binary faces by the size of the first one.
"""

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..mesh import SurfaceError
from ._ply_header import CORNERS, Element, Header, read_header
from ._words import (
    TRIANGULATE,
    coordinates,
    count,
    face,
    mesh_arrays,
    short_of,
    text_of,
    wide_encoding,
    without_mark,
)

_CODES = {
    "i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d",
}  # fmt: skip


def parse_ply(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a PLY file, vertex numbers not yet checked against the vertices.

    Other properties, lists among them, and other elements are not read.
    """
    if wide_encoding(data):
        text_of(name, data, "PLY")  # says in which encoding it is
    data = without_mark(data)
    header = read_header(name, data)
    if header.order:
        return _binary(name, data, header)
    return _text(name, data[header.start :], header)


def _text(name: str, body: bytes, header: Header):
    text = body.decode("utf-8", errors="replace")
    split = ((n, line.split()) for n, line in enumerate(text.splitlines(), start=header.line))
    lines = [(n, words) for n, words in split if words]
    vertices, faces = [], []
    for element in header.elements:
        mine, lines = lines[: element.length], lines[element.length :]
        if len(mine) < element.length:
            raise short_of(name, _entries_of(element), element.length, len(mine))
        if element.name == "vertex":
            names = [p.name for p in element.properties]
            at = [names.index(axis) for axis in "xyz"]
            for n, words in mine:
                values = _values(name, n, words, element)
                point = [word for i in at if i < len(values) for word in values[i]]
                vertices.append(coordinates(name, n, point))
        elif element.name == "face":
            corners = next(i for i, p in enumerate(element.properties) if p.name in CORNERS)
            for n, words in mine:
                values = _values(name, n, words, element)
                faces.append(face(name, n, values[corners] if corners < len(values) else []))
    return mesh_arrays(name, vertices, faces)


def _values(name: str, line: int, words: list[str], element: Element) -> list[list[str]]:
    """The words of one line, property by property, as far as they go."""
    position, found = 0, []
    for prop in element.properties:
        if position >= len(words):
            break
        size = 1 if prop.count_type is None else count(name, line, words[position], "entries")
        position += prop.count_type is not None
        found.append(words[position : position + size])
        if len(found[-1]) < size and prop.name in CORNERS:
            raise short_of(f"{name}, line {line}", "corners", size, len(found[-1]))
        position += size
    return found


def _binary(name: str, data: bytes, header: Header):
    vertices, faces, start = np.empty((0, 3)), np.empty((0, 3)), header.start
    for element in header.elements:
        columns, start = _columns(name, data, start, header.order, element)
        if element.name == "vertex":
            with np.errstate(invalid="ignore"):  # NaN of damaged files is named by the check
                vertices = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=-1)
        elif element.name == "face":
            faces = next(columns[corners] for corners in CORNERS if corners in columns)
    return vertices, faces


def _columns(
    name: str, data: bytes, start: int, order: str, element: Element
) -> tuple[dict[str, Any], int]:
    """The properties of all entries of an element as arrays, and where the next one begins.

    Lists of one length throughout, as those of triangles are, make the entries a table. Where
    lengths differ, entries are looked at one by one.
    """
    sizes = next(_entries(name, data, start, order, element), None)
    if sizes is None:  # no entries, or nothing in them
        nothing = {p.name: np.empty((0, 3) if p.count_type else 0) for p in element.properties}
        return nothing, start
    _refuse_polygon(name, 0, element, sizes[1])
    fields: list[Any] = []
    for at, (prop, size) in enumerate(zip(element.properties, sizes[1], strict=True)):
        if prop.count_type is not None:
            fields.append((f"count {at}", order + prop.count_type))
        shape = () if prop.count_type is None else (size,)
        fields.append((f"value {at}", order + prop.type, shape))
    table_of = np.dtype(fields)
    found = (len(data) - start) // table_of.itemsize
    table = np.frombuffer(data, table_of, count=min(element.length, found), offset=start)
    lengths = [table[f] for f in table_of.names or () if f.startswith("count ")]
    if all(np.all(length == length[:1]) for length in lengths):
        if found < element.length:
            raise short_of(name, _entries_of(element), element.length, found)
        columns = {p.name: table[f"value {at}"] for at, p in enumerate(element.properties)}
        return columns, start + element.length * table_of.itemsize
    return _uneven(name, data, start, order, element)


def _uneven(name: str, data: bytes, start: int, order: str, element: Element):
    """As `_columns`, entry by entry; of the lists only the one with the corners is kept."""
    is_face = element.name == "face"
    kept = [p.count_type is None or is_face and p.name in CORNERS for p in element.properties]
    rows: list[list[Any]] = [[] for _ in element.properties]
    for number, entry in enumerate(_entries(name, data, start, order, element)):
        places, sizes, start = entry
        _refuse_polygon(name, number, element, sizes)
        for at, prop in enumerate(element.properties):
            if kept[at]:
                code = f"{order}{sizes[at]}{_CODES[prop.type]}"
                values = struct.unpack_from(code, data, places[at])
                rows[at].append(values[0] if prop.count_type is None else values)
    columns = {p.name: np.array(rows[at]) for at, p in enumerate(element.properties) if kept[at]}
    return columns, start


def _entries(
    name: str, data: bytes, start: int, order: str, element: Element
) -> Iterator[tuple[list[int], list[int], int]]:
    """Where the values of each entry stand, how many they are, and where the entry ends.

    The one place that compares lengths with the file.
    """
    if not element.properties:
        return
    position = start
    for number in range(element.length):
        places, sizes = [], []
        for prop in element.properties:
            size = 1
            if prop.count_type is not None:
                code = order + _CODES[prop.count_type]
                if position + struct.calcsize(code) > len(data):
                    raise short_of(name, _entries_of(element), element.length, number)
                (size,) = struct.unpack_from(code, data, position)
                position += struct.calcsize(code)
            if size < 0:
                raise SurfaceError(
                    f"{name}: entry {number} of {element.name[:40]!r} has a list "
                    f"{prop.name[:40]!r} of {size} entries; the file is damaged."
                )
            places.append(position)
            sizes.append(size)
            position += size * int(prop.type[1])
            if position > len(data):
                raise short_of(name, _entries_of(element), element.length, number)
        yield places, sizes, position


def _entries_of(element: Element) -> str:
    return f"entries of {element.name[:40]!r}"


def _refuse_polygon(name: str, number: int, element: Element, sizes: list[int]) -> None:
    for prop, size in zip(element.properties, sizes, strict=True):
        if element.name == "face" and prop.name in CORNERS and size != 3:
            raise SurfaceError(f"{name}: face {number} has {size} corners. {TRIANGULATE}.")

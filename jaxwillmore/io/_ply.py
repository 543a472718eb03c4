"""PLY files: reading text and binary, writing surfaces of any degree as fine triangles.

Read here and not by trimesh, which cuts off faces of a truncated text file, drops the fraction of
a vertex number, and reads binary faces by the size of the first one.
"""

import os
from typing import Any, NamedTuple

import numpy as np

from ..mesh import SurfaceError, SurfaceMesh
from ..reference import lagrange_nodes
from ._atomic import atomic_write
from ._plain import HostNodes
from ._words import TRIANGULATE, coordinates, count, face, mesh_arrays, short_of

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER = 2**16


class _Property(NamedTuple):
    name: str
    type: str
    count_type: str | None  # None for a single number


class _Element(NamedTuple):
    name: str
    length: int
    properties: list[_Property]


def _header(name: str, data: bytes) -> tuple[str, list[_Element], int, int]:
    """Byte order ("" for text), elements, where the body begins, and in which line."""
    end = data.find(b"end_header", 0, _MAX_HEADER)
    newline = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or newline < 0:
        raise SurfaceError(f"{name}: not a PLY file, or truncated: its header does not end.")
    lines = data[:end].decode("utf-8", errors="replace").splitlines()
    order, elements = None, []
    for number, line in enumerate(lines[1:], start=2):
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", word, "1.0"] if word in _ORDERS:
                order = _ORDERS[word]
            case ["element", word, length]:
                elements.append(_Element(word, count(name, number, length, word), []))
            case ["property", "list", size, type, word] if (
                elements and size in _TYPES and type in _TYPES
            ):
                elements[-1].properties.append(_Property(word, _TYPES[type], _TYPES[size]))
            case ["property", type, word] if elements and type in _TYPES:
                elements[-1].properties.append(_Property(word, _TYPES[type], None))
            case _:
                raise SurfaceError(f"{name}, line {number}: not a PLY header: {line[:80]!r}.")
    if order is None:
        raise SurfaceError(f"{name}: the PLY header does not name a format that can be read.")
    return order, elements, newline + 1, len(lines) + 2


def _check_elements(name: str, elements: list[_Element], n_bytes: int) -> list[_Element]:
    """The elements up to the faces, or a complaint about what is missing."""
    kinds = [element.name for element in elements]
    if kinds.count("vertex") != 1 or kinds.count("face") != 1:
        raise SurfaceError(f"{name}: the PLY file needs vertices and faces; it has {kinds}.")
    elements = elements[: max(kinds.index("vertex"), kinds.index("face")) + 1]
    for element in elements:
        if element.length > n_bytes:  # every entry takes at least one byte
            raise SurfaceError(
                f"{name}: the header announces {element.length} entries of {element.name!r} in a "
                f"file of {n_bytes} bytes; it is damaged."
            )
        names = [p.name for p in element.properties]
        if len(set(names)) < len(names):
            raise SurfaceError(f"{name}: the element {element.name!r} has a property twice.")
        listed = [p.name for p in element.properties if p.count_type]
        if element.name == "face":
            if len({"vertex_index", "vertex_indices"} & set(listed)) != 1:
                raise SurfaceError(f"{name}: the faces have no list named `vertex_indices`.")
        elif listed:
            raise SurfaceError(f"{name}: lists in the element {element.name!r} are not read.")
    missing = {"x", "y", "z"} - {p.name for e in elements if e.name == "vertex" for p in e[2]}
    if missing:
        raise SurfaceError(f"{name}: the vertices have no property {sorted(missing)}.")
    return elements


def parse_ply(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a PLY file, vertex numbers not yet checked against the vertices."""
    order, elements, start, first_line = _header(name, data)
    elements = _check_elements(name, elements, len(data) - start)
    if order:
        return _binary(name, data, start, order, elements)
    return _text(name, data[start:], first_line, elements)


def _text(name: str, body: bytes, first_line: int, elements: list[_Element]):
    text = body.decode("utf-8", errors="replace")
    split = ((n, line.split()) for n, line in enumerate(text.splitlines(), start=first_line))
    lines = [(n, words) for n, words in split if words]
    vertices, faces = [], []
    for element in elements:
        mine, lines = lines[: element.length], lines[element.length :]
        if len(mine) < element.length:
            raise short_of(name, f"entries of {element.name!r}", element.length, len(mine))
        names = [p.name for p in element.properties]
        if element.name == "vertex":
            at = [names.index(axis) for axis in "xyz"]
            for n, words in mine:
                point = [words[i] for i in at if i < len(words)]
                vertices.append(coordinates(name, n, point))
        elif element.name == "face":
            faces = [face(name, n, _corners(name, n, words, element)) for n, words in mine]
    return mesh_arrays(name, vertices, faces)


def _corners(name: str, line: int, words: list[str], element: _Element) -> list[str]:
    """The words of the list of vertices in a line that may hold other properties too."""
    position = 0
    for prop in element.properties:
        if position >= len(words):
            break
        size = 1 if prop.count_type is None else count(name, line, words[position], "corners")
        position += prop.count_type is not None
        if prop.name in ("vertex_index", "vertex_indices"):
            found = words[position : position + size]
            if len(found) < size:
                raise short_of(f"{name}, line {line}", "corners", size, len(found))
            return found
        position += size
    raise short_of(f"{name}, line {line}", "corners", 3, 0)


def _binary(name: str, data: bytes, start: int, order: str, elements: list[_Element]):
    vertices, faces = np.empty((0, 3)), np.empty((0, 3))
    for element in elements:
        fields = []
        for number, prop in enumerate(element.properties):
            if prop.count_type is None:
                fields.append((prop.name, order + prop.type))
                continue
            # lists must have one length throughout for the entries to be a table
            offset = start + np.dtype(fields).itemsize
            head = data[offset : offset + np.dtype(prop.count_type).itemsize]
            length = int(np.frombuffer(head, order + prop.count_type)[0]) if len(head) else 0
            if prop.name in ("vertex_index", "vertex_indices") and length != 3 and element.length:
                raise SurfaceError(f"{name}: face 0 has {length} corners. {TRIANGULATE}.")
            fields.append((f"count {number}", order + prop.count_type))
            fields.append((prop.name, order + prop.type, (length,)))
        dtype = np.dtype(fields)
        found = (len(data) - start) // max(dtype.itemsize, 1)
        if found < element.length:
            raise short_of(name, f"entries of {element.name!r}", element.length, found)
        table = np.frombuffer(data, dtype, count=element.length, offset=start)
        start += element.length * dtype.itemsize
        for field in dtype.names or ():
            uneven = field.startswith("count ") and table[field] != table[field][:1]
            if np.any(uneven):
                worst = int(np.argmax(uneven))
                raise SurfaceError(
                    f"{name}: face {worst} has a list of {table[field][worst]} entries, face 0 one "
                    f"of {table[field][0]}. {TRIANGULATE}."
                )
        if element.name == "vertex":
            vertices = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
        elif element.name == "face":
            listed = {"vertex_index", "vertex_indices"} & set(dtype.names or ())
            faces = table[min(listed)]
    return vertices, faces


def linear_triangles(mesh: SurfaceMesh) -> np.ndarray:
    """Plain triangles through all nodes: degree² of them for every curved triangle."""
    k = mesh.degree
    lattice = np.rint(lagrange_nodes(k) * k).astype(int)
    local = {(int(i), int(j)): number for number, (i, j) in enumerate(lattice)}
    up = [(i, j) for j in range(k) for i in range(k - j)]
    down = [(i, j) for j in range(k - 1) for i in range(k - 1 - j)]
    corners = [[local[i, j], local[i + 1, j], local[i, j + 1]] for i, j in up]
    corners += [[local[i + 1, j], local[i + 1, j + 1], local[i, j + 1]] for i, j in down]
    return np.asarray(mesh.cells)[:, corners].reshape(-1, 3)


def write_ply(
    path: str | os.PathLike[str],
    mesh: SurfaceMesh,
    x: HostNodes,
    fields: dict[str, Any] | None = None,
) -> None:
    """Write a surface as binary PLY in double precision, atomically.

    PLY knows flat triangles only: a surface of degree k is written as k² of them per element,
    through its own nodes. `write_npz` keeps the degree.

    **Arguments:**

    - `fields`: name -> one number or vector per node, stored as properties `name` or `name_x`,
        `name_y`, `name_z`; a field named `normal` as `nx`, `ny`, `nz`, as every viewer expects.
    """
    points = np.asarray(x, dtype=np.float64)
    columns = dict(zip("xyz", points.T, strict=True))
    for name, field in (fields or {}).items():
        values = np.asarray(field, dtype=np.float64)
        if values.shape not in ((len(points),), (len(points), 3)):
            raise ValueError(
                f"field {name!r} needs one number or vector for each of the {len(points)} nodes; "
                f"got an array of shape {values.shape}."
            )
        word = "_".join(name.split())
        if values.ndim == 1:
            columns[word] = values
        elif name == "normal":
            columns.update(zip(("nx", "ny", "nz"), values.T, strict=True))
        else:
            columns.update(zip([f"{word}_{axis}" for axis in "xyz"], values.T, strict=True))
    vertex = np.empty(len(points), [(name, "<f8") for name in columns])
    for name, column in columns.items():
        vertex[name] = column
    triangles = linear_triangles(mesh)
    face = np.empty(len(triangles), [("n", "u1"), ("corners", "<i4", 3)])
    face["n"], face["corners"] = 3, triangles
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment surface of degree {mesh.degree}, {mesh.n_cells} elements",
        f"element vertex {len(points)}",
        *(f"property double {name}" for name in columns),
        f"element face {len(triangles)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    with atomic_write(path) as file:
        file.write("\n".join([*header, ""]).encode("utf-8"))
        file.write(vertex.tobytes())
        file.write(face.tobytes())

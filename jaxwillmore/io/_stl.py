"""STL files, binary and text. Read here and not by trimesh, which reads normals nobody needs and
complains about them, and cuts off faces of a truncated text file.
"""

import struct

import numpy as np

from ..mesh import SurfaceError
from ._words import coordinates, text_of, wide_encoding, without_mark

_HEAD, _TRIANGLE = 84, 50
_TABLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def parse_stl(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an STL file, corners at exactly the same place made one vertex.

    The format stores three points per triangle and no connectivity, so this much has to be done
    for it to be a surface at all. All solids in a file are one surface; normals and colours are
    not read.
    """
    announced = struct.unpack("<I", data[80:84])[0] if len(data) >= _HEAD else None
    size = len(data) + 1 if announced is None else _HEAD + _TRIANGLE * announced
    is_text = without_mark(data).lstrip()[:5].lower() == b"solid" and b"\0" not in data
    if size != len(data) and (wide_encoding(data) or is_text and size > len(data)):
        corners = _text(name, text_of(name, data, "STL"))
    else:
        corners = _binary(name, data, announced)
    # + 0.0 because STL writers produce -0.0 beside 0.0 for the same point
    corners = corners + 0.0
    _, first, numbers = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # back from sorted points to the order of the file
    new_number = np.empty_like(order)
    new_number[order] = np.arange(len(order))
    return corners[first[order]], new_number[numbers.reshape(-1, 3)]


def _binary(name: str, data: bytes, announced: int | None) -> np.ndarray:
    """Three corners per triangle; up to 49 bytes behind the last one do no harm."""
    if announced is None:
        raise SurfaceError(f"{name}: not an STL file, or truncated: it has only {len(data)} bytes.")
    size = _HEAD + _TRIANGLE * announced
    if size > len(data):
        raise SurfaceError(
            f"{name}: not a whole STL file, truncated or damaged: it announces {announced} "
            f"triangles, which take {size} bytes, and has {len(data)}."
        )
    if len(data) - size >= _TRIANGLE:
        raise SurfaceError(
            f"{name}: {len(data) - size} bytes are left over behind the {announced} triangles "
            "the file announces; it is damaged, or more than one file in one."
        )
    if announced == 0:
        raise SurfaceError(f"{name}: the surface is empty: no triangles.")
    table = np.frombuffer(data, _TABLE, count=announced, offset=_HEAD)
    with np.errstate(invalid="ignore"):  # NaN of damaged files is named by the check
        return table["corners"].reshape(-1, 3).astype(np.float64)


def _text(name: str, text: str) -> np.ndarray:
    """The same of a text file."""
    corners, begun, closed = [], 0, False
    for line, content in enumerate(text.splitlines(), start=1):
        words = content.split()
        kind = words[0].lower() if words else ""
        if kind in ("solid", "endsolid"):
            closed = kind == "endsolid"
            continue  # what follows is a name, which may be any words
        for at, word in enumerate(map(str.lower, words)):
            if word == "vertex":
                corners.append(coordinates(name, line, words[at + 1 : at + 4]))
            elif word in ("facet", "endfacet"):
                if len(corners) - begun != (3 if word == "endfacet" else 0):
                    raise SurfaceError(
                        f"{name}, line {line}: a facet with {len(corners) - begun} corners instead "
                        "of 3; the file is damaged."
                    )
                begun = len(corners)
    if begun != len(corners) or not closed:
        raise SurfaceError(
            f"{name}: not a whole STL file, truncated or damaged: it does not end with `endsolid`."
        )
    if not corners:
        raise SurfaceError(f"{name}: the surface is empty: the STL file has no triangles.")
    return np.array(corners)

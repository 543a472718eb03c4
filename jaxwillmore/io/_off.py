"""OFF files. Read here and not by trimesh, which cuts polygons into triangles without a word."""

import numpy as np

from ..mesh import SurfaceError
from ._words import coordinates, count, face, mesh_arrays, short_of, text_of

# Colours, normals and texture coordinates follow the position, so they can be left unread.
_KEYWORDS = {"OFF", "COFF", "NOFF", "CNOFF", "STOFF", "STCOFF", "STNOFF", "STCNOFF"}


def parse_off(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an OFF file, vertex numbers not yet checked against the vertices."""
    text = text_of(name, data, "OFF")
    split = ((n, line.split("#")[0].split()) for n, line in enumerate(text.splitlines(), start=1))
    lines = [(n, words) for n, words in split if words]
    if not lines or lines[0][1][0] not in _KEYWORDS:
        raise SurfaceError(f"{name}: not an OFF file: it does not begin with the word OFF.")
    number, (_, *counts) = lines.pop(0)
    if not counts and lines:
        number, counts = lines.pop(0)
    if len(counts) < 2:
        raise SurfaceError(
            f"{name}: the numbers of vertices and faces after OFF are missing; the file is "
            "truncated."
        )
    n_vertices = count(name, number, counts[0], "vertices")
    n_faces = count(name, number, counts[1], "faces")
    if len(lines) < n_vertices:
        raise short_of(name, "vertices", n_vertices, len(lines))
    if len(lines) < n_vertices + n_faces:
        raise short_of(name, "faces", n_faces, len(lines) - n_vertices)
    if len(lines) > n_vertices + n_faces:
        raise SurfaceError(
            f"{name}, line {lines[n_vertices + n_faces][0]}: the file goes on after the "
            f"{n_vertices} vertices and {n_faces} faces it announces."
        )
    vertices = [coordinates(name, n, words) for n, words in lines[:n_vertices]]
    faces = []
    for n, (corners, *words) in lines[n_vertices:]:
        wanted = count(name, n, corners, "corners")
        if len(words) < wanted:
            raise short_of(f"{name}, line {n}", "corners", wanted, len(words))
        faces.append(face(name, n, words[:wanted]))
    return mesh_arrays(name, vertices, faces)

"""OBJ files. Read here and not by trimesh, which reads index 0 as the last vertex, drops vertices
that are not numbers, and opens the surface along seams of texture coordinates.
"""

import numpy as np

from ..mesh import SurfaceError
from ._words import coordinates, face, mesh_arrays, text_of


def parse_obj(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an OBJ file; all groups and objects in it are one surface.

    Normals, texture coordinates, colours, lines and materials are not read, and no other file is
    ever opened.
    """
    text = text_of(name, data, "OBJ").replace("\\\n", " ").replace("\\\r\n", " ")
    vertices, faces, face_lines = [], [], []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(coordinates(name, number, words[1:]))
        elif words[0] == "f":
            corners = face(name, number, [word.split("/")[0] for word in words[1:]])
            if 0 in corners:
                raise SurfaceError(
                    f"{name}, line {number}: vertex number 0; OBJ files count from 1."
                )
            # negative numbers count back from the vertex read last
            faces.append([c - 1 if c > 0 else len(vertices) + c for c in corners])
            face_lines.append(number)
    if not vertices or not faces:
        raise SurfaceError(
            f"{name}: not an OBJ surface: it has {len(vertices)} vertices (lines beginning with "
            f"'v') and {len(faces)} faces ('f')."
        )
    for number, corners in zip(face_lines, faces, strict=True):
        if min(corners) < 0 or max(corners) >= len(vertices):
            raise SurfaceError(
                f"{name}, line {number}: this face names a vertex that is not in the file, which "
                f"has {len(vertices)}."
            )
    return mesh_arrays(name, vertices, faces)

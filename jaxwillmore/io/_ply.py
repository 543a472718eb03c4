"""PLY files: surfaces of any degree written as fine triangles."""

import os
from typing import Any

import numpy as np

from ..mesh import SurfaceMesh
from ..reference import lagrange_nodes
from ._atomic import atomic_write
from ._plain import HostNodes


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

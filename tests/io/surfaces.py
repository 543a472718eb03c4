"""A small good surface in every format, and pieces to build bad ones from."""

import struct

import numpy as np

from jaxwillmore.mesh import icosphere


def ball(level=1, radius=1.0):
    """Vertices and faces of an icosphere, NumPy."""
    mesh, x = icosphere(level, degree=1, radius=radius)
    return np.array(x), np.array(mesh.cells, dtype=np.int64)


def rows(array):
    return [" ".join(map(repr, row)) for row in array.tolist()]


def off_text(v, f):
    return "\n".join(["OFF", f"{len(v)} {len(f)} 0", *rows(v), *("3 " + r for r in rows(f)), ""])


def obj_text(v, f):
    return "\n".join([*("v " + r for r in rows(v)), *("f " + r for r in rows(f + 1)), ""])


def ply_header(n_vertices, n_faces, format="ascii", index="int"):
    return "\n".join(
        [
            "ply",
            f"format {format} 1.0",
            f"element vertex {n_vertices}",
            *(f"property double {axis}" for axis in "xyz"),
            f"element face {n_faces}",
            f"property list uchar {index} vertex_indices",
            "end_header",
            "",
        ]
    )


def ply_text(v, f):
    return ply_header(len(v), len(f)) + "\n".join([*rows(v), *("3 " + r for r in rows(f)), ""])


def ply_bytes(v, f, order="<"):
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    table = np.zeros(len(f), [("n", "u1"), ("i", order + "i4", (3,))])
    table["n"], table["i"] = 3, f
    return (
        ply_header(len(v), len(f), name).encode()
        + v.astype(order + "f8").tobytes()
        + table.tobytes()
    )


def stl_bytes(v, f):
    table = np.zeros(len(f), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")])
    table["corners"] = v[f]
    return b"\0" * 80 + struct.pack("<I", len(f)) + table.tobytes()


def stl_text(v, f):
    lines = ["solid ball"]
    for corners in v[f].tolist():
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(map(repr, p)) for p in corners]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid ball", ""])

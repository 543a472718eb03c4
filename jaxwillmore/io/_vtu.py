"""Frames for ParaView: one VTU file per time, elements curved as they were computed."""

import base64
import os
import struct
import zlib
from collections.abc import Iterator
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from ..mesh import SurfaceMesh
from ._atomic import atomic_write
from ._plain import HostNodes

# VTK's cell types: linear, quadratic, and arbitrary-order Lagrange triangle. Their local orders
# (vertices, nodes of the edges 01, 12, 20, interior) are the ones of `reference.lagrange_nodes`.
VTK_CELL_TYPE = {1: 5, 2: 22, 3: 69, 4: 69}

_VTK_TYPE = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}
_BLOCK = 2**20


def _encode(array: np.ndarray) -> str:
    """Base64 text of zlib blocks behind the header VTK expects: counts, sizes, packed sizes."""
    data = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
    blocks = [data[i : i + _BLOCK] for i in range(0, len(data), _BLOCK)]
    packed = [zlib.compress(block) for block in blocks]
    sizes = [len(blocks), _BLOCK, len(data) % _BLOCK, *map(len, packed)]
    header = struct.pack(f"<{len(sizes)}Q", *sizes)
    return (base64.b64encode(header) + base64.b64encode(b"".join(packed))).decode("ascii")


def _data_array(name: str, array: np.ndarray, attributes: str = "") -> str:
    if array.ndim > 1:
        attributes += f' NumberOfComponents="{array[0].size}"'
    kind = _VTK_TYPE[array.dtype.name]
    head = f'<DataArray type="{kind}" Name={quoteattr(name)}{attributes} format="binary">'
    return f"{head}\n{_encode(array)}\n</DataArray>\n"


def _point_data(fields: dict[str, Any], n_nodes: int) -> Iterator[str]:
    for name, field in fields.items():
        values = np.asarray(field, dtype=np.float64)
        if values.ndim not in (1, 2, 3) or values.shape[0] != n_nodes or values.size == 0:
            raise ValueError(
                f"field {name!r} needs one number, vector or matrix for each of the {n_nodes} "
                f"nodes; got an array of shape {values.shape}."
            )
        yield _data_array(name, values)


def write_vtu(
    path: str | os.PathLike[str],
    mesh: SurfaceMesh,
    x: HostNodes,
    fields: dict[str, Any] | None = None,
    time: float | None = None,
) -> None:
    """Write a surface and fields on its nodes as a VTK XML file, atomically.

    Everything is stored in double precision without loss (binary, compressed). Degree 1 and 2 are
    VTK's linear and quadratic triangles (cell types 5 and 22), degree 3 and 4 its Lagrange
    triangles (type 69), so ParaView draws the curved elements that were computed.

    **Arguments:**

    - `fields`: name -> one number, vector or 3 by 3 matrix per node.
    - `time`: stored as `TimeValue`.

    **Raises:** `ValueError` when a field does not have one entry per node.
    """
    points = np.asarray(x, dtype=np.float64)
    cells = np.asarray(mesh.cells, dtype=np.int64)
    n_cells, n_local = cells.shape
    clock = ""
    if time is not None:
        clock = _data_array("TimeValue", np.array([time]), ' NumberOfTuples="1"')
        clock = f"<FieldData>\n{clock}</FieldData>\n"
    parts = [
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" '
        'byte_order="LittleEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">\n'
        "<UnstructuredGrid>\n",
        clock,
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{n_cells}">\n<Points>\n',
        _data_array("Points", points),
        "</Points>\n<Cells>\n",
        _data_array("connectivity", cells.ravel()),
        _data_array("offsets", np.arange(1, n_cells + 1) * n_local),
        _data_array("types", np.full(n_cells, VTK_CELL_TYPE[mesh.degree], np.uint8)),
        "</Cells>\n<PointData>\n",
        *_point_data(fields or {}, len(points)),
        "</PointData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n",
    ]
    with atomic_write(path, "w") as file:
        file.writelines(parts)

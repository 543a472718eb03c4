"""Frames of a run as surfaces: VTU files as `write_vtu` makes them, and none of the other kinds."""

import base64
import struct
import zlib
from xml.etree import ElementTree

import numpy as np

from ..mesh import SurfaceError
from ._words import without_mark

_TYPES = {"Float64": "f8", "Float32": "f4", "Int64": "i8", "Int32": "i4", "UInt8": "u1"}
_DEGREE = {(5, 3): 1, (22, 6): 2, (69, 10): 3, (69, 15): 4}
_HEADER = {"UInt64": "Q", "UInt32": "I"}
_COMPRESSOR = "vtkZLibDataCompressor"
_LARGE, _MOST_PACKED = 2**26, 100  # as for NPZ files
_OTHER = (
    "Only frames of this package are read; convert others, for example with "
    "`pyvista.read(file).extract_surface().triangulate().save('surface.ply')`"
)


class _Damaged(ValueError):
    """Why a file cannot be read."""


def parse_vtu(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray, int]:
    """Nodes, cells and degree of a frame; its fields are not read.

    **Raises:** `SurfaceError` for anything but one piece of triangles of one degree, with arrays
    in the file as text or packed by zlib.
    """
    try:
        return _surface(data)
    except _Damaged as error:
        raise SurfaceError(f"{name}: {error}.") from error
    except (ElementTree.ParseError, zlib.error, struct.error, ValueError, OverflowError) as error:
        raise SurfaceError(
            f"{name}: not a whole VTU file, truncated or damaged ({error!s:.200})."
        ) from error


def _surface(data: bytes) -> tuple[np.ndarray, np.ndarray, int]:
    if b"<!" in without_mark(data).replace(b"<!--", b""):
        raise _Damaged("it declares entities, which a frame has no use for")
    root = ElementTree.fromstring(without_mark(data))
    pieces = root.findall("UnstructuredGrid/Piece")
    if root.tag != "VTKFile" or len(pieces) != 1:
        kind = root.get("type", root.tag)
        raise _Damaged(f"it is no unstructured grid of one piece, but {kind[:40]!r}. {_OTHER}")
    limit = max(_LARGE, _MOST_PACKED * len(data))
    arrays = {
        place: _array(root, pieces[0], place, limit)
        for place in (
            "Points/DataArray",
            "Cells/DataArray[@Name='connectivity']",
            "Cells/DataArray[@Name='offsets']",
            "Cells/DataArray[@Name='types']",
        )
    }
    points, connectivity, offsets, types = arrays.values()
    if points.size % 3 or points.dtype.kind != "f":
        raise _Damaged(f"its points are {points.size} numbers of type {points.dtype}")
    n_local, rest = divmod(connectivity.size, max(len(types), 1))
    kinds = np.unique(types).tolist()
    degree = _DEGREE.get((kinds[0], n_local)) if len(kinds) == 1 and not rest else None
    if degree is None or not np.array_equal(offsets, n_local * np.arange(1, len(types) + 1)):
        raise _Damaged(
            f"its {len(types)} cells are not all triangles of one degree (types of VTK: "
            f"{kinds[:5]}). {_OTHER}"
        )
    return points.reshape(-1, 3), connectivity.reshape(-1, n_local).astype(np.int64), degree


def _array(root, piece, place: str, limit: int) -> np.ndarray:
    found = piece.find(place)
    if found is None:
        raise _Damaged(f"it has no `{place}`; it is truncated or damaged")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    type, format = found.get("type", ""), found.get("format", "")
    if type not in _TYPES:
        raise _Damaged(f"`{place}` holds numbers of type {type[:40]!r}")
    text = found.text or ""
    if format == "ascii":
        with np.errstate(over="ignore", invalid="ignore"):  # named by the check
            return np.array(text.split()).astype(_TYPES[type])
    counts = _HEADER.get(root.get("header_type", "UInt32"))
    if format != "binary" or root.get("compressor") != _COMPRESSOR or counts is None:
        raise _Damaged(f"its arrays are stored as {format[:40]!r}, or not packed by zlib. {_OTHER}")
    content = _unpacked("".join(text.split()), order + counts, limit)
    dtype = np.dtype(order + _TYPES[type])
    if len(content) % dtype.itemsize:
        raise _Damaged(f"`{place}` holds {len(content)} bytes, no whole number of {type}")
    return np.frombuffer(content, dtype).astype(_TYPES[type])


def _unpacked(text: str, counts: str, limit: int) -> bytes:
    """The content of base64 text: counts of blocks, then zlib blocks; never more than `limit`."""
    size = struct.calcsize(counts)
    (n_blocks,) = struct.unpack_from(counts, base64.b64decode(text[:12], validate=False))
    if n_blocks > len(text):
        raise _Damaged(f"{n_blocks} blocks are announced in {len(text)} letters")
    n_letters = 4 * -(-(3 + n_blocks) * size // 3)
    header = base64.b64decode(text[:n_letters], validate=True)
    form = f"{counts[0]}{3 + n_blocks}{counts[1]}"
    _, block_size, _, *packed = struct.unpack_from(form, header)
    data = base64.b64decode(text[n_letters:], validate=True)
    if sum(packed) != len(data):
        raise _Damaged(f"{sum(packed)} bytes are announced, {len(data)} are there; it is damaged")
    blocks, start = [], 0
    for length in packed:
        most = min(block_size, limit)
        blocks.append(zlib.decompressobj().decompress(data[start : start + length], most + 1))
        limit -= len(blocks[-1])
        if len(blocks[-1]) > most or limit < 0:
            raise _Damaged("a block unpacks to more than is announced; it is damaged")
        start += length
    return b"".join(blocks)

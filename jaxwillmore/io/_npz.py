"""NPZ files: surfaces written with all their digits, and a reader that trusts nothing."""

import io
import math
import os
import re
import struct
import zipfile
import zlib
from typing import Any

import numpy as np

from ..mesh import SurfaceMesh
from ._atomic import atomic_write
from ._plain import HostNodes

# Everything `zipfile`, `zlib` and NumPy raise on a damaged or hostile file.
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
)

# Deflate packs zeros a thousandfold. Arrays of a surface that large are packed a few times.
_LARGE, _MOST_PACKED = 2**26, 100
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

_MAX_HEADER = 10_000
_FIELDS = {
    "descr": re.compile(r"""['"]descr['"]\s*:\s*['"]([^'"]*)['"]"""),
    "fortran_order": re.compile(r"""['"]fortran_order['"]\s*:\s*(True|False)"""),
    "shape": re.compile(r"""['"]shape['"]\s*:\s*\(([^()]*)\)"""),
}


class NpzError(ValueError):
    """A file is not an NPZ archive of plain arrays, or is damaged."""


def _header(data: bytes) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """Shape, whether columns come first, type, and where the numbers begin.

    Three patterns instead of NumPy's parser, which hands whatever stands there to Python's.
    """
    if data[:6] != b"\x93NUMPY" or len(data) < 12:
        raise ValueError("it does not begin as an array does")
    wide = data[6] > 1
    start = 12 if wide else 10
    (size,) = struct.unpack_from("<I" if wide else "<H", data, 8)
    if size > _MAX_HEADER or start + size > len(data):
        raise ValueError(f"its header is {size} bytes long")
    text = data[start : start + size].decode("latin-1")
    found = {name: pattern.search(text) for name, pattern in _FIELDS.items()}
    descr, order, shape = (match and match.group(1) for match in found.values())
    if descr is None or order is None or shape is None:
        raise ValueError("its header is not that of an array of numbers")
    lengths = [word.strip().removesuffix("L") for word in shape.split(",") if word.strip()]
    if not all(word.isdecimal() and len(word) < 19 for word in lengths):
        raise ValueError(f"its header announces the shape ({shape:.40})")
    return tuple(map(int, lengths)), order == "True", np.dtype(descr), start + size


def _member(data: bytes) -> np.ndarray:
    shape, fortran, dtype, start = _header(data)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never loaded")
    n_bytes = math.prod(shape) * dtype.itemsize
    # NumPy would allocate whatever the header announces before looking at the data
    if n_bytes != len(data) - start:
        raise ValueError(f"its header announces {n_bytes} bytes, it holds {len(data) - start}")
    array = np.frombuffer(data, dtype, count=math.prod(shape), offset=start)
    return array.reshape(shape, order="F" if fortran else "C").copy()


def _refuse_bomb(members: list[zipfile.ZipInfo], n_packed: int, max_bytes: int) -> None:
    """Complain about an archive that announces more than its length can honestly hold.

    No more than what is announced here is unpacked later.
    """
    size = sum(member.file_size for member in members)
    if size > max_bytes:
        raise NpzError(f"it unpacks to {size} bytes; at most {max_bytes} are read")
    if size > max(_LARGE, _MOST_PACKED * n_packed):
        raise NpzError(
            f"it unpacks from {n_packed} to {size} bytes, more than {_MOST_PACKED} times as many; "
            "no surface does. Save it with `numpy.savez`, uncompressed, if it is one"
        )
    for member in members:
        if member.compress_type not in _METHODS:
            raise NpzError(f"its array {member.filename!r:.80} is packed in an unusual way")


def read_npz(
    file: io.BufferedIOBase, max_bytes: int = 2**30, max_members: int = 64
) -> dict[str, np.ndarray]:
    """All arrays of an NPZ file, with checks of size, names and checksums before use.

    **Raises:** `NpzError` when the archive is truncated, damaged, too large once unpacked, or
    holds anything but arrays of numbers.
    """
    arrays = {}
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            if len(members) > max_members:
                raise NpzError(f"it holds {len(members)} arrays; at most {max_members} are read")
            _refuse_bomb(members, file.seek(0, os.SEEK_END), max_bytes)
            for member in members:
                name = member.filename.removesuffix(".npy")
                if name == member.filename or name in arrays:
                    raise NpzError(f"its member {member.filename!r:.80} is not one array")
                try:
                    with archive.open(member) as stream:
                        # `archive.read` unpacks everything before it compares with the size
                        arrays[name] = _member(stream.read(member.file_size))
                except _DAMAGED as error:
                    raise NpzError(f"its array {name!r:.80} is damaged: {error!s:.200}") from error
    except NpzError:
        raise
    except _DAMAGED as error:
        raise NpzError(f"not an NPZ archive, truncated or damaged ({error!s:.200})") from error
    return arrays


def save_arrays(
    file: Any, arrays: dict[str, np.ndarray], compression: int = zipfile.ZIP_STORED
) -> None:
    """As `numpy.savez`, but any name will do, and equal arrays make equal files."""
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # dated 1980, not now
            member.compress_type = compression
            with archive.open(member, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)


def write_npz(
    path: str | os.PathLike[str],
    mesh: SurfaceMesh,
    x: HostNodes,
    fields: dict[str, Any] | None = None,
) -> None:
    """Write a surface of any degree with all its digits; `read_surface` reads it back exactly.

    The arrays are `x`, `cells`, `degree` and one per entry of `fields`. The write is atomic.
    """
    fields = dict(fields or {})
    taken = {"x", "cells", "degree", "vertices", "faces"} & set(fields)
    if taken:
        raise ValueError(f"the field name {sorted(taken)[0]!r} is taken; choose another one.")
    arrays = {
        "x": np.asarray(x),
        "cells": np.asarray(mesh.cells),
        "degree": np.asarray(mesh.degree),
        **{name: np.asarray(field) for name, field in fields.items()},
    }
    with atomic_write(path) as file:
        save_arrays(file, arrays, zipfile.ZIP_DEFLATED)

"""NPZ files: surfaces written with all their digits, and a reader that trusts nothing."""

import io
import math
import os
import struct
import zipfile
import zlib
from typing import Any

import numpy as np

from ..mesh import SurfaceMesh
from ._atomic import atomic_write
from ._plain import HostNodes

# Everything `zipfile`, `zlib` and NumPy's header parser raise on a damaged or hostile file.
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    ArithmeticError,
    EOFError,
    LookupError,
    NotImplementedError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
)


class NpzError(ValueError):
    """A file is not an NPZ archive of plain arrays, or is damaged."""


def _member(data: bytes) -> np.ndarray:
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never loaded")
    n_bytes = math.prod(shape) * dtype.itemsize
    start = stream.tell()
    # NumPy would allocate whatever the header announces before looking at the data
    if n_bytes != len(data) - start:
        raise ValueError(f"its header announces {n_bytes} bytes, it holds {len(data) - start}")
    array = np.frombuffer(data, dtype, count=math.prod(shape), offset=start)
    return array.reshape(shape, order="F" if fortran else "C").copy()


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
            size = sum(member.file_size for member in members)
            if size > max_bytes:
                raise NpzError(f"it unpacks to {size} bytes; at most {max_bytes} are read")
            for member in members:
                name = member.filename.removesuffix(".npy")
                if name == member.filename or name in arrays:
                    raise NpzError(f"its member {member.filename!r:.80} is not one array")
                try:
                    arrays[name] = _member(archive.read(member))
                except _DAMAGED as error:
                    raise NpzError(f"its array {name!r:.80} is damaged: {error}") from error
    except NpzError:
        raise
    except _DAMAGED as error:
        raise NpzError(f"not an NPZ archive, truncated or damaged ({error})") from error
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

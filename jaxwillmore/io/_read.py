"""Any closed surface of a user as `(mesh, x)`, or an error that says what is wrong with it."""

import io
import os
import warnings
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import Nodes
from ..mesh import (
    SurfaceError,
    SurfaceMesh,
    SurfaceReport,
    check_mesh,
    check_surface,
    raise_degree,
    repair as repaired,
)
from ..reference import lagrange_basis, lagrange_nodes
from ._neighbours import arrays_of
from ._npz import NpzError, read_npz
from ._obj import parse_obj
from ._off import parse_off
from ._ply_read import parse_ply
from ._raised import raised
from ._source import read_bytes
from ._stl import parse_stl
from ._vtu_read import parse_vtu

_PARSERS = {"ply": parse_ply, "off": parse_off, "obj": parse_obj, "stl": parse_stl}
_DEGREE = {3: 1, 6: 2, 10: 3, 15: 4}

_LARGEST = 1e75

# Findings that no repair can work with.
_HOPELESS = {
    "empty_surface",
    "index_out_of_range",
    "index_type_too_small",
    "non_finite_coordinates",
    "unreadable_faces",
    "unreadable_vertices",
}


class SurfaceWarning(UserWarning):
    """A surface can be used, but something about it deserves a look."""


class _Raw(NamedTuple):
    """What a source holds before it is checked: a triangulation, or cells of higher degree."""

    name: str
    x: Any
    cells: Any
    degree: int = 1


def _from_npz(name: str, data: bytes, max_bytes: int) -> _Raw:
    try:
        arrays = read_npz(io.BytesIO(data), max_bytes=max_bytes)
    except NpzError as error:
        raise SurfaceError(f"{name}: {error}.") from error
    if {"vertices", "faces"} <= set(arrays):
        return _Raw(name, arrays["vertices"], arrays["faces"])
    if not {"x", "cells"} <= set(arrays):
        raise SurfaceError(
            f"{name}: it needs the arrays `x` and `cells`, or `vertices` and `faces`; it holds "
            f"{sorted(arrays)[:10]}."
        )
    cells = arrays["cells"]
    if cells.ndim != 2 or cells.shape[1] not in _DEGREE:
        raise SurfaceError(
            f"{name}: `cells` needs 3, 6, 10 or 15 node numbers per triangle; its shape is "
            f"{cells.shape}."
        )
    return _Raw(name, arrays["x"], cells, _DEGREE[cells.shape[1]])


def _raw(source: Any, max_bytes: int) -> _Raw:
    if isinstance(source, (str, os.PathLike)):
        name = f"`{os.fspath(source)}`"
        format, data = read_bytes(source, max_bytes)
        if format == "npz":
            return _from_npz(name, data, max_bytes)
        if format == "vtu":
            return _Raw(name, *parse_vtu(name, data))
        return _Raw(name, *_PARSERS[format](name, data))
    return _Raw(*arrays_of(source))


class Reading(NamedTuple):
    """A surface that was read, with what the check says of it and what was repaired."""

    name: str
    """What was read, as messages call it."""
    mesh: SurfaceMesh
    x: Nodes
    report: SurfaceReport
    repairs: tuple[str, ...] = ()
    """A sentence for everything that was done to the surface."""


def _raise_if_bad(name: str, report: SurfaceReport, repairs: tuple[str, ...] = ()) -> None:
    if not report.ok:
        done = f" (after repairs: {'; '.join(repairs)})" if repairs else ""
        raise SurfaceError(f"{name}{done}: {report}", report)


def _warn(reading: Reading) -> None:
    for act in reading.repairs:
        warnings.warn(f"{reading.name}: repaired: {act}.", SurfaceWarning, stacklevel=3)
    for finding in reading.report.warnings:
        warnings.warn(f"{reading.name}: {finding}", SurfaceWarning, stacklevel=3)


def _refuse_overflow(name: str, vertices: Any) -> None:
    """Coordinates whose fourth power is no number, as damaged files hold them."""
    if not isinstance(vertices, np.ndarray) or vertices.dtype != np.float64:
        return  # the check reports other types
    vertices = np.ma.getdata(vertices)
    largest = np.max(np.abs(vertices), where=np.isfinite(vertices), initial=0.0)
    if largest > _LARGEST:
        raise SurfaceError(
            f"{name}: coordinates up to {largest:.3g}; the fourth power of lengths overflows. "
            "The file is damaged, or needs a larger unit of length."
        )


class _Repairs(NamedTuple):
    """What may be done to a surface, as `read_surface` was asked."""

    merge_tolerance: float | None
    fix_orientation: bool
    repair: bool
    keep: Literal["largest"] | None

    @property
    def any(self) -> bool:
        return self != (None, False, False, None)


def _flat(raw: _Raw, repairs: _Repairs, expected: dict) -> Reading:
    """The triangulation as a mesh of degree 1, repaired as far as was asked for."""
    vertices, faces, acts = raw.x, raw.cells, ()
    _refuse_overflow(raw.name, vertices)
    report = check_surface(vertices, faces, **expected)
    if not report.ok and repairs.any:
        if _HOPELESS & set(report.kinds):
            _raise_if_bad(raw.name, report)
        try:
            vertices, faces, acts = repaired(
                vertices,
                faces,
                merge=repairs.merge_tolerance,
                collapsed=repairs.repair,
                repeated=repairs.repair,
                keep=repairs.keep,
                components=expected["components"],
                unused=repairs.repair,
                outward=repairs.repair or repairs.fix_orientation,
            )
        except SurfaceError as error:
            raise SurfaceError(f"{raw.name}: {error}", error.report) from error
        report = check_surface(vertices, faces, **expected)
    _raise_if_bad(raw.name, report, acts)
    x = np.asarray(vertices, dtype=np.float64)
    mesh = SurfaceMesh(np.asarray(faces, np.int64), 1, len(x))
    return Reading(raw.name, mesh, jnp.asarray(x), report, acts)


def _curved(raw: _Raw, repairs: _Repairs, expected: dict) -> Reading:
    """A surface of degree 2 to 4 as this package wrote it."""
    x = np.asarray(raw.x)
    if x.ndim != 2 or x.shape[1] != 3 or x.dtype.kind != "f":
        raise SurfaceError(f"{raw.name}: `x` needs real numbers of shape (n, 3); got {x.shape}.")
    _refuse_overflow(raw.name, x)
    try:
        mesh = SurfaceMesh(raw.cells, raw.degree, len(x))
    except ValueError as error:
        raise SurfaceError(f"{raw.name}: {error}") from error
    report = check_mesh(mesh, x, **expected)
    if repairs.any and not report.ok:
        raise SurfaceError(
            f"{raw.name}: {report}\nNothing was repaired: only flat triangles are, and these have "
            f"degree {raw.degree}.",
            report,
        )
    _raise_if_bad(raw.name, report)
    return Reading(raw.name, mesh, jnp.asarray(x, dtype=np.float64), report)


def _change_degree(
    mesh: SurfaceMesh, x: Float[Array, "old_nodes 3"], degree: int
) -> tuple[SurfaceMesh, Nodes]:
    """The curved surface itself, seen at the nodes of another degree."""
    if degree == mesh.degree:
        return mesh, x
    vertices = x[: mesh.n_vertices]
    flat = SurfaceMesh(cells=mesh.triangles, degree=1, n_nodes=mesh.n_vertices)
    new, new_x = raise_degree(flat, vertices, degree) if degree > 1 else (flat, vertices)
    phi = lagrange_basis(mesh.degree, lagrange_nodes(degree))
    values = np.einsum("ij,cjd->cid", phi, np.asarray(x)[np.asarray(mesh.cells)])
    on_nodes = np.array(new_x)
    on_nodes[np.asarray(new.cells)] = values
    return new, jnp.asarray(on_nodes)


def examine_surface(
    source: Any,
    degree: int | None = None,
    merge_tolerance: float | None = None,
    fix_orientation: bool = False,
    repair: bool = False,
    keep: Literal["largest"] | None = None,
    components: int = 1,
    genus: int | None = None,
    max_bytes: int = 2**30,
) -> Reading:
    """As `read_surface`, but report and repairs are returned, and nothing is warned of."""
    if degree is not None and (isinstance(degree, bool) or degree not in (1, 2, 3, 4)):
        raise ValueError(f"`degree` must be 1, 2, 3 or 4; got {degree!r}.")
    if merge_tolerance is not None and not (merge_tolerance >= 0 and np.isfinite(merge_tolerance)):
        raise ValueError(f"`merge_tolerance` must be a length >= 0; got {merge_tolerance}.")
    if keep not in (None, "largest"):
        raise ValueError(f'`keep` must be "largest" or None; got {keep!r}.')
    if components < 1 or (genus is not None and genus < 0):
        raise ValueError(
            f"`components` must be 1 or more and `genus` 0 or more; got {components} and {genus}."
        )
    raw = _raw(source, max_bytes)
    expected = {"components": components, "genus": genus}
    repairs = _Repairs(merge_tolerance, fix_orientation, repair, keep)
    if raw.degree > 1:
        reading = _curved(raw, repairs, expected)
        wanted = reading.mesh.degree if degree is None else degree
        mesh, x = _change_degree(reading.mesh, reading.x, wanted)
    else:
        reading = _flat(raw, repairs, expected)
        mesh, x = reading.mesh, reading.x
        if degree is not None and degree > 1:
            mesh, x, report = raised(mesh, x, degree, reading.report)
            reading = reading._replace(report=report)
    return reading._replace(mesh=mesh, x=x)


def read_surface(
    source: Any,
    degree: int | None = None,
    merge_tolerance: float | None = None,
    fix_orientation: bool = False,
    repair: bool = False,
    keep: Literal["largest"] | None = None,
    components: int = 1,
    genus: int | None = None,
    max_bytes: int = 2**30,
) -> tuple[SurfaceMesh, Nodes]:
    """Read a closed surface, check it, and raise it to a polynomial degree.

    Curved triangles that change area or volume by more than 3 % are told by a `SurfaceWarning`.
    Nothing is repaired unless asked for, and then every act is told: a surface with holes, flipped
    or duplicate faces, unmerged or unused vertices and the like (`jaxwillmore.mesh.check_surface`
    has the list) is an error that names the places. Coordinates are kept as they are, whatever the
    unit of length; numbers in single precision (binary PLY and STL usually hold nothing better) are
    converted to double. Formats, in the order of preference: NPZ (exact, any degree), PLY, OFF,
    OBJ, STL.

    STL files hold loose triangles. For them alone, corners at *exactly* the same place become one
    vertex by default, because without it no STL file is a surface.

    **Arguments:**

    - `source`: a path ending in .ply, .off, .obj, .stl, .npz or .vtu (a frame of a run, in its
        degree); a `trimesh.Trimesh`, `pyvista.PolyData` or `meshio.Mesh` (never changed); or
        arrays (vertices, faces), as the first two that marching cubes return.
    - `degree`: 1 to 4. New nodes are put on a smooth curved surface through the vertices, not on
        the flat triangles. Default: the degree in the file, which is 1 except for NPZ and VTU
        files written by this package; those keep their own curved surface under a change of degree.
    - `merge_tolerance`: make one vertex of vertices at most this far apart (same unit as the
        coordinates).
    - `fix_orientation`: turn faces over until all point outwards.
    - `repair`: drop faces that name a vertex twice, repeated faces and vertices without a face, and
        turn faces over until all point outwards, as `jaxwillmore.mesh.repair` does.
    - `keep`: `"largest"` keeps the `components` pieces with the largest areas.
    - `components`: how many separate pieces there should be.
    - `genus`: how many handles there should be, if that is known.
    - `max_bytes`: refuse larger files.

    **Returns:** `(mesh, x)`.

    **Raises:** `jaxwillmore.mesh.SurfaceError` (a `ValueError`) saying which file, what is wrong,
    where, and what to do; `FileNotFoundError`; `IsADirectoryError`; `TypeError` for other sources.
    Warns with `SurfaceWarning` about what may be wrong but can be used, and tells every repair so.

    ```python
    mesh, x = jw.io.read_surface("cell.ply", degree=2)
    ```
    """
    reading = examine_surface(
        source,
        degree,
        merge_tolerance,
        fix_orientation,
        repair,
        keep,
        components,
        genus,
        max_bytes,
    )
    _warn(reading)
    return reading.mesh, reading.x

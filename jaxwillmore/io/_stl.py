"""STL files, read by trimesh: binary and text."""

import io
import warnings

import numpy as np

from ..mesh import SurfaceError


def parse_stl(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an STL file, corners at exactly the same place made one vertex.

    The format stores three points per triangle and no connectivity, so this much has to be done
    for it to be a surface at all.
    """
    from trimesh.exchange.stl import HeaderError, load_stl

    if len(data) < 15:
        raise SurfaceError(f"{name}: not an STL file: it has only {len(data)} bytes.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # text that is not numbers is otherwise cut off there
            loaded = load_stl(io.BytesIO(data))
    except (ValueError, HeaderError, LookupError, ImportError, DeprecationWarning) as error:
        raise SurfaceError(
            f"{name}: not a whole STL file, truncated or damaged ({error}). Text files need "
            "decimal points, not commas."
        ) from error
    solids = loaded.get("geometry", {})
    if len(solids) > 1:
        raise SurfaceError(
            f"{name}: the file holds {len(solids)} solids ({', '.join(list(solids)[:5])}); "
            "write each one to a file of its own."
        )
    if "vertices" not in loaded:
        raise SurfaceError(f"{name}: {_why_nothing(data)}.")
    _check_text(name, data, len(loaded["vertices"]))
    # + 0.0 because STL writers produce -0.0 beside 0.0 for the same point
    corners = np.asarray(loaded["vertices"], dtype=np.float64) + 0.0
    _, first, numbers = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # back from sorted points to the order of the file
    new_number = np.empty_like(order)
    new_number[order] = np.arange(len(order))
    return corners[first[order]], new_number[numbers.reshape(-1, 3)]


def _why_nothing(data: bytes) -> str:
    """Why trimesh found no triangle."""
    if len(data) == 84:
        return "the surface is empty: no triangles"
    if data.lstrip()[:5].lower() == b"solid":
        return "not a whole STL file, truncated or damaged: no solid in it is complete"
    announced = int.from_bytes(data[80:84], "little")
    return (
        f"not a whole STL file, truncated or damaged: it announces {announced} triangles, which "
        f"take {84 + 50 * announced} bytes, and has {len(data)}"
    )


def _check_text(name: str, data: bytes, n_corners: int) -> None:
    """Refuse a text file of which trimesh understood less than it holds."""
    if len(data) == 84 + 50 * (n_corners // 3):
        return  # binary: trimesh compares the header with the length itself
    found = data.lower().count(b"endfacet")
    if 3 * found != n_corners:
        raise SurfaceError(
            f"{name}: {n_corners} corners in {found} complete triangles; the file is truncated or "
            "damaged."
        )

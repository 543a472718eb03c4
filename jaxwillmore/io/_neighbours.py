"""Surfaces that live in memory, in the form other libraries give them."""

from typing import Any

import numpy as np

from ..mesh import SurfaceError

_KINDS = (
    "a surface is read from a path, a `trimesh.Trimesh`, a `pyvista.PolyData`, or arrays "
    "(vertices, faces), to which normals and values of marching cubes may be added"
)

_VTK_TRIANGLE = 5


def arrays_of(source: Any) -> tuple[str, Any, Any]:
    """What to call the source, its vertices and its faces, not yet checked.

    **Raises:** `TypeError` for anything that has none, saying how to get them; `SurfaceError`
    for polygons.
    """
    name = f"the {type(source).__name__}"
    if isinstance(source, (tuple, list)) and len(source) == 2:
        return "(vertices, faces)", *source
    if isinstance(source, tuple) and len(source) in (3, 4) and _is_pair(*source[:2]):
        return "(vertices, faces)", *source[:2]  # skimage.measure.marching_cubes
    vertices = getattr(source, "vertices", None)
    for attribute in ("faces", "triangles"):  # trimesh and its kin; open3d
        faces = getattr(source, attribute, None)
        if vertices is not None and faces is not None:
            return name, np.asarray(vertices), np.asarray(faces)
    points = getattr(source, "points", None)
    cells = getattr(source, "cells_dict", None)
    if points is not None and isinstance(cells, dict):  # meshio, and grids of pyvista
        kinds = [key if isinstance(key, str) else int(key) for key in cells]
        if kinds in (["triangle"], [_VTK_TRIANGLE]):
            return name, np.asarray(points), np.asarray(*cells.values())
        raise TypeError(f"{name} holds cells of the kinds {kinds}; pass its triangles alone.")
    faces = getattr(source, "faces", None)
    if points is not None and faces is not None:  # pyvista.PolyData
        return name, np.asarray(points), _triangles(name, np.asarray(faces))
    if points is not None:  # other grids of pyvista
        way = "`.extract_surface().triangulate()`"
        raise TypeError(f"{name} is no surface; pass its surface as {way} gives it.")
    if getattr(source, "geometry", None) is not None:  # trimesh.Scene
        raise TypeError(f"{name} may hold several surfaces; pass one of its `.geometry.values()`.")
    raise TypeError(f"{_KINDS}; got {type(source).__name__}.")


def _is_pair(vertices: Any, faces: Any) -> bool:
    shapes = np.shape(vertices), np.shape(faces)
    return all(len(shape) == 2 and shape[1] == 3 for shape in shapes)


def _triangles(name: str, faces: np.ndarray) -> np.ndarray:
    """The corners out of VTK's list, in which every face begins with the number of its corners."""
    if faces.ndim == 1 and faces.size % 4 == 0 and np.all(faces[::4] == 3):
        return faces.reshape(-1, 4)[:, 1:]
    raise SurfaceError(f"{name}: not all faces are triangles; pass its `.triangulate()`.")

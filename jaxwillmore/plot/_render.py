"""Surfaces as images: by PyVista in a process of its own, or by matplotlib."""

import importlib.util
import itertools as it
import os
import pathlib
import subprocess
import sys
import tempfile
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from ._camera import Camera
from ._error import PlotError, matplotlib_figure
from ._subdivide import FineSurface

_WORKER = pathlib.Path(__file__).with_name("_pyvista_worker.py")
_PATIENCE = 180.0  # seconds; a first import from a network disk can be slow
_PATIENCE_PER_SCENE = 20.0


Image = UInt8[np.ndarray, "pixels pixels 3"]
Colours = UInt8[np.ndarray, "points 3"]


def _edge_opacity(surface: FineSurface) -> float:
    """Fainter the more edges there are: a fine mesh must not darken the picture."""
    return float(np.clip(0.34 * (500.0 / len(surface.edges)) ** 0.4, 0.06, 0.34))


def pyvista_images(
    surfaces: Sequence[FineSurface],
    colours: Sequence[Colours],
    camera: Camera,
    edges: bool,
    pixels: int,
) -> list[Image]:
    """Draw surfaces with PyVista, off-screen, without a display, all in one process.

    **Raises:** `PlotError` when PyVista is missing or cannot draw on this machine.
    """
    if importlib.util.find_spec("pyvista") is None or not sys.executable:
        raise PlotError("PyVista is not installed.")
    environment = dict(os.environ, PYVISTA_OFF_SCREEN="true")
    if not environment.get("DISPLAY"):
        environment.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    with tempfile.TemporaryDirectory(prefix="jaxwillmore-") as folder:
        files = []
        for number, (surface, colour) in enumerate(zip(surfaces, colours, strict=True)):
            scene = os.path.join(folder, f"scene{number}.npz")
            picture = os.path.join(folder, f"picture{number}.npy")
            np.savez(scene, **_scene(surface, colour, camera, edges, pixels))
            files.append((scene, picture))
        command = [sys.executable, "-P", os.fspath(_WORKER), *it.chain(*files)]
        try:
            done = subprocess.run(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_PATIENCE + _PATIENCE_PER_SCENE * len(files),
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise PlotError(f"PyVista could not be run: {error}") from error
        if done.returncode != 0 or not all(os.path.exists(picture) for _, picture in files):
            words = done.stderr.decode(errors="replace").strip().splitlines()
            reason = words[-1] if words else f"it ended with code {done.returncode}"
            raise PlotError(f"PyVista cannot draw on this machine: {reason[:300]}")
        return [np.load(picture) for _, picture in files]


def _scene(surface: FineSurface, colours: Colours, camera: Camera, edges: bool, pixels: int):
    """What the process that draws has to know of a surface."""
    return {
        "points": surface.points,
        "normals": surface.normals,
        "triangles": surface.triangles,
        "edges": surface.edges if edges else surface.edges[:0],
        "edge_opacity": _edge_opacity(surface),
        "contour": surface.contour,
        "colours": colours,
        "axes": camera.axes,
        "centre": camera.centre(surface.points),
        "half_height": camera.half_height,
        "pixels": pixels,
    }


def matplotlib_images(
    surfaces: Sequence[FineSurface],
    colours: Sequence[Colours],
    camera: Camera,
    edges: bool,
    pixels: int,
) -> list[Image]:
    """Draw surfaces with matplotlib alone.

    **Raises:** `PlotError` when matplotlib is missing.
    """
    drawn = zip(surfaces, colours, strict=True)
    return [_by_matplotlib(surface, c, camera, edges, pixels) for surface, c in drawn]


def _by_matplotlib(
    surface: FineSurface, colours: Colours, camera: Camera, edges: bool, pixels: int
) -> Image:
    """Triangles from the back to the front, with light."""
    figure = matplotlib_figure(4.0, 4.0)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PolyCollection

    figure.set_dpi(pixels / 4.0)
    seen = (surface.points - camera.centre(surface.points)) @ camera.axes.T
    normals = surface.normals @ camera.axes.T
    front = normals[surface.triangles, 2].max(axis=1) > 0.0
    triangles = surface.triangles[front]
    shade = _light(normals)[triangles].mean(axis=1)
    colour = colours[triangles].mean(axis=1) / 255.0
    lit = np.clip(colour * shade[:, :1] + shade[:, 1:], 0.0, 1.0)
    polygons = list(seen[triangles][..., :2])
    depth = seen[triangles][..., 2].mean(axis=1)
    face = np.concatenate([lit, np.ones((len(lit), 1))], axis=1)
    line, width = face.copy(), np.full(len(face), 0.4)
    if edges:
        pieces = np.stack([surface.edges[:, :-1], surface.edges[:, 1:]], axis=-1).reshape(-1, 2)
        pieces = pieces[normals[pieces, 2].min(axis=1) > 0.0]
        polygons += list(seen[pieces][..., :2])
        # just in front of the triangles they belong to
        depth = np.concatenate(
            [depth, seen[pieces][..., 2].mean(axis=1) + 0.03 * camera.half_height]
        )
        face = np.concatenate([face, np.zeros((len(pieces), 4))])
        black = np.tile([0.0, 0.0, 0.0, _edge_opacity(surface)], (len(pieces), 1))
        line = np.concatenate([line, black])
        width = np.concatenate([width, np.full(len(pieces), 0.5)])
    if len(surface.contour):
        ends = (surface.contour - camera.centre(surface.points)) @ camera.axes.T
        nearest = _nearest(surface.points, surface.contour.mean(axis=1))
        seen_line = ends[normals[nearest, 2] > 0.0]
        polygons += list(seen_line[..., :2])
        depth = np.concatenate([depth, seen_line[..., 2].mean(axis=1) + 0.06 * camera.half_height])
        face = np.concatenate([face, np.zeros((len(seen_line), 4))])
        line = np.concatenate([line, np.tile([0.0, 0.0, 0.0, 1.0], (len(seen_line), 1))])
        width = np.concatenate([width, np.full(len(seen_line), 1.6)])
    order = np.argsort(depth)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set(
        xlim=np.array([-1, 1]) * camera.half_height, ylim=np.array([-1, 1]) * camera.half_height
    )
    axes.add_collection(
        PolyCollection(
            [polygons[i] for i in order],
            facecolors=face[order],
            edgecolors=line[order],
            linewidths=width[order],
        )
    )
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def _nearest(points, places):
    from scipy.spatial import KDTree

    return KDTree(points).query(places)[1]


def _light(normals: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 2"]:
    """How much of its own colour, and how much white, a point shows; axes of the camera."""
    key, fill = np.array([-0.7, 0.9, 1.3]), np.array([1.2, -0.3, 0.8])
    key, fill = key / np.linalg.norm(key), fill / np.linalg.norm(fill)
    diffuse = 0.48 * np.maximum(normals @ key, 0.0) + 0.24 * np.maximum(normals @ fill, 0.0)
    half = key + [0.0, 0.0, 1.0]
    gloss = 0.1 * np.maximum(normals @ (half / np.linalg.norm(half)), 0.0) ** 24
    return np.stack([0.46 + diffuse, gloss], axis=-1)

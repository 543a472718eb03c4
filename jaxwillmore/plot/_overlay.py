"""Pictures of a fit: outlines of target and model over each other, and profiles of a misfit."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..mesh import SurfaceMesh
from ._error import matplotlib_figure, save
from ._subdivide import subdivide

_TARGET, _MODEL, _INK, _GREY = "#8a94a0", "#c23b3b", "#1f2933", "#e3e7ec"


def section(
    mesh: SurfaceMesh,
    x: Float[np.ndarray, "nodes 3"],
    centre: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "segments 2 3"]:
    """Where a plane cuts a surface: segments on small flat pieces of the curved triangles."""
    fine = subdivide(mesh, x)
    height = (fine.points - centre) @ normal
    # A vertex exactly in the plane would belong to no side.
    height = np.where(height == 0.0, 1e-300, height)
    cut = fine.triangles[np.ptp(np.sign(height[fine.triangles]), axis=1) > 0]
    segments = []
    for triangle in cut:
        ends = []
        for a, b in zip(triangle, np.roll(triangle, -1), strict=True):
            if height[a] * height[b] < 0:
                t = height[a] / (height[a] - height[b])
                ends.append((1 - t) * fine.points[a] + t * fine.points[b])
        segments.append(ends)
    return np.array(segments).reshape(-1, 2, 3)


def overlay_picture(
    path: str | os.PathLike[str],
    target: tuple[SurfaceMesh, Any],
    model: tuple[SurfaceMesh, Any],
    *,
    title: str = "",
    unit: str = "",
    dpi: float = 150.0,
) -> None:
    """Three cross-sections of an observed surface (grey) and of the model that was fitted (red).

    The planes go through the mean node of the target, along its principal axes.

    **Raises:** `PlotError` when no picture can be made.
    """
    from matplotlib.collections import LineCollection

    points, nodes = np.asarray(target[1], float), np.asarray(model[1], float)
    centre = points.mean(axis=0)
    axes = np.linalg.eigh(np.cov((points - centre).T))[1].T
    figure = matplotlib_figure(12.0, 4.6)
    reach = 1.06 * np.max(np.abs(np.concatenate([points, nodes]) - centre))
    for k in range(3):
        panel = figure.add_subplot(1, 3, k + 1)
        plane = np.delete(axes, k, axis=0)[::-1]
        for (mesh, x), colour, width, label in (
            ((target[0], points), _TARGET, 3.2, "target"),
            ((model[0], nodes), _MODEL, 1.3, "fit"),
        ):
            flat = (section(mesh, x, centre, axes[k]) - centre) @ plane.T
            lines = LineCollection(list(flat), colors=colour, linewidths=width, label=label)
            lines.set_capstyle("round")
            panel.add_collection(lines)
        panel.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        panel.set_title(f"across principal axis {k + 1}", size=11, color=_INK)
        panel.tick_params(labelsize=9, colors=_INK)
        panel.grid(True, color=_GREY, lw=0.7)
        panel.set_axisbelow(True)
        if unit:
            panel.set_xlabel(unit, size=10, color=_INK)
        if k == 0:
            panel.legend(frameon=False, fontsize=10, loc="upper right", labelcolor=_INK)
    figure.suptitle(title, size=13, color=_INK)
    figure.tight_layout(rect=(0, 0, 1, 0.97))
    save(figure, path, dpi)


def profile_picture(
    path: str | os.PathLike[str],
    profiles: Mapping[str, tuple[Any, Any]],
    best: Mapping[str, float],
    *,
    ylabel: str,
    title: str = "",
    dpi: float = 150.0,
) -> None:
    """The misfit along each parameter, the others following; a line marks where the fit ended.

    **Arguments:**

    - `profiles`: for each name the values and the misfits there.
    - `best`: the fitted values.
    """
    figure = matplotlib_figure(max(4.6 * len(profiles), 5.0), 4.0)
    for k, (name, (values, misfits)) in enumerate(profiles.items()):
        panel = figure.add_subplot(1, len(profiles), k + 1)
        panel.plot(values, misfits, "-o", color=_MODEL, lw=1.6, ms=4)
        panel.axvline(best[name], color=_TARGET, lw=1.2, ls="--")
        panel.set_xlabel(name, size=11, color=_INK)
        panel.set_ylabel(ylabel if k == 0 else "", size=11, color=_INK)
        panel.tick_params(labelsize=9, colors=_INK)
        panel.grid(True, color=_GREY, lw=0.7)
        panel.set_axisbelow(True)
    figure.suptitle(title, size=13, color=_INK)
    figure.tight_layout(rect=(0, 0, 1, 0.96))
    save(figure, path, dpi)

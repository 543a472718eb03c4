"""The picture of a branch: energy over its parameter, with shapes along it."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from ._camera import camera_for
from ._error import PlotError, matplotlib_figure, save
from ._surface import colours_of, fine_surface, images_of, scale_of

_BLUE, _ORANGE, _GREY, _INK = "#2563a8", "#d9822b", "#8a94a0", "#1f2933"
_LABELS = {
    "reduced_volume": "reduced volume v",
    "spontaneous_curvature": "spontaneous curvature H₀",
    "pressure": "pressure P",
    "mean": "mean concentration",
    "line_tension": "line tension λ",
    "interface_width": "interface width ℓ",
    "bending_over_8pi_kappa": "E / 8πκ",
    "total_energy": "energy E",
}
_MOST_SHAPES = 6


def branch_picture(
    path: str | os.PathLike[str],
    rows: Sequence[dict[str, Any]],
    surfaces: Sequence[tuple[Any, Any, Any]],
    parameter: str,
    *,
    energy: str = "bending_over_8pi_kappa",
    field_name: str = "H",
    title: str | None = None,
    renderer: str = "auto",
    dpi: float = 130.0,
) -> None:
    """Draw a branch of equilibria into a PNG file: its energy over the parameter that was followed.

    Above the curve stand up to six of its shapes at one scale, coloured by a field. Stable points
    are filled, unstable ones open. Folds and bifurcations are marked.

    **Arguments:**

    - `rows`: one dictionary per point with the parameter, the energy, `negative_directions`, and
      `event`: `"fold"`, `"bifurcation"` or `None`.
    - `surfaces`: mesh, nodes and a nodal field of every point.
    - `energy`: the column that is drawn, E/(8πκ) by default.
    - `field_name`: what the nodal field is, `"H"` or `"c"`.

    **Raises:** `PlotError` when there are no points, matplotlib is missing, or the file cannot be
    written.
    """
    if not rows or len(rows) != len(surfaces):
        raise PlotError(f"a branch needs a surface per row; got {len(surfaces)} for {len(rows)}.")
    p = np.array([float(row[parameter]) for row in rows])
    E = np.array([float(row[energy]) for row in rows])
    negative = np.array([float(row["negative_directions"]) for row in rows])
    figure = matplotlib_figure(10.0, 7.4)
    axes = figure.add_axes((0.095, 0.1, 0.875, 0.56))
    axes.plot(p, E, color=_BLUE, lw=1.6, zorder=2)
    for chosen, face, label in (
        (negative == 0, _BLUE, "stable"),
        (negative > 0, "white", "unstable"),
        (~np.isfinite(negative), _GREY, "stability not known"),
    ):
        if np.any(chosen):
            axes.plot(p[chosen], E[chosen], "o", ms=6.5, mfc=face, mec=_BLUE, label=label, zorder=3)
    for event, marker in (("fold", "D"), ("bifurcation", "o")):
        there = [number for number, row in enumerate(rows) if row["event"] == event]
        if there:
            style = {"ms": 11, "mfc": "none", "mec": _ORANGE, "ls": ""}
            axes.plot(p[there], E[there], marker, label=event, **style)
    _style(axes, _LABELS.get(parameter, parameter), _LABELS.get(energy, energy))
    _thumbnails(figure, axes, p, E, surfaces, field_name, renderer, dpi)
    if title is not None:
        figure.suptitle(title, size=14, color=_INK, y=0.975)
    save(figure, path, dpi)


def _style(axes, across: str, up: str) -> None:
    axes.set_xlabel(across, size=13, color=_INK)
    axes.set_ylabel(up, size=13, color=_INK)
    axes.tick_params(labelsize=11, color=_GREY, labelcolor=_INK)
    axes.grid(True, color="#e3e7ec", lw=0.8)
    axes.set_axisbelow(True)
    axes.margins(0.06, 0.1)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(_GREY)
    axes.legend(fontsize=11, frameon=False, labelcolor=_INK, loc="best")


def _thumbnails(figure, axes, p, energy, surfaces, name, renderer: str, dpi: float) -> None:
    """Shapes in a row above the axes, each tied to its point by a thin line."""
    chosen = _spread(p, energy, min(_MOST_SHAPES, len(p)))
    chosen = chosen[np.argsort(p[chosen], kind="stable")]
    fine = [fine_surface(*surfaces[k]) for k in chosen]
    scale = scale_of([s.values for s in fine if s.values is not None], name, None)
    camera = camera_for([surface.points for surface in fine])
    width = 0.875 / max(len(chosen), 3)
    pixels = round(width * 10.0 * dpi)
    colours = [colours_of(surface, scale) for surface in fine]
    images = images_of(fine, colours, camera, False, pixels, renderer)
    # The part of the height of the square images that is not empty.
    extent = max(np.ptp(surface.points @ camera.axes[1]) for surface in fine)
    tall = min(0.04 + extent / (2 * camera.half_height), 1.0)
    height = tall * width * 10.0 / 7.4
    bottom = 0.69 + max(0.0, 0.5 * (0.25 - height))
    left = 0.095 + 0.5 * (0.875 - width * len(chosen))
    for number, (k, image) in enumerate(zip(chosen, images, strict=True)):
        cut = round(0.5 * (1 - tall) * len(image))
        box = figure.add_axes((left + number * width, bottom, width, height))
        box.imshow(image[cut : len(image) - cut], aspect="auto")
        box.set_axis_off()
        axes.annotate(
            "",
            (p[k], energy[k]),
            (left + (number + 0.5) * width, bottom),
            textcoords="figure fraction",
            arrowprops={"arrowstyle": "-", "lw": 0.9, "color": _GREY, "shrinkB": 5},
            annotation_clip=False,
        )


def _spread(p: np.ndarray, energy: np.ndarray, count: int) -> np.ndarray:
    """Points about evenly spaced along the curve, the first and the last among them."""
    extent = [max(np.ptp(values), 1e-300) for values in (p, energy)]
    steps = np.hypot(np.diff(p) / extent[0], np.diff(energy) / extent[1])
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, along[-1], count)
    return np.unique([int(np.argmin(np.abs(along - w))) for w in wanted])

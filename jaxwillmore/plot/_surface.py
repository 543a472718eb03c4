"""A picture of a surface: curved elements, a field in colour, start beside end."""

import os
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from .._types import Nodes
from ..mesh import SurfaceMesh
from ._camera import Camera, camera_for
from ._error import PlotError, matplotlib_figure, save
from ._render import matplotlib_images, pyvista_images
from ._subdivide import FineSurface, subdivide, with_contour

_DIVERGING = ("H", "K", "V", "mean curvature", "Gaussian curvature", "normal velocity")
_PLAIN = (0.64, 0.73, 0.84)
_INK = "#1f2933"


class _Scale(NamedTuple):
    """From values to colours."""

    name: str
    low: float
    high: float
    extend: str
    """Which end of the colour bar has values beyond it, in matplotlib's words."""


def _host(what: str, values: Any, n_nodes: int, *rest: int) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (n_nodes, *rest):
        raise ValueError(f"`{what}` needs shape {(n_nodes, *rest)}; got {array.shape}.")
    return array


def fine_surface(mesh: SurfaceMesh, x: Any, field: Any) -> FineSurface:
    """A surface and a field on it, checked and cut fine enough to be drawn."""
    x = _host("x", x, mesh.n_nodes, 3)
    if not np.all(np.isfinite(x)):
        n = np.count_nonzero(~np.all(np.isfinite(x), axis=1))
        raise PlotError(f"{n} of {len(x)} nodes are not finite; there is no surface to draw.")
    return subdivide(mesh, x, None if field is None else _host("field", field, mesh.n_nodes))


def scale_of(values: list[np.ndarray], name: str, cmap: str | None) -> _Scale:
    """Symmetric about zero for signed fields; the extreme 0.4 % may saturate."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    if len(finite) == 0:
        raise PlotError(f"the field {name!r} has no finite value to draw.")
    low, high = np.quantile(finite, [0.002, 0.998])
    # the bulk decides only where there are outliers worth cutting off
    spare = 0.25 * (high - low)
    low = finite.min() if low - finite.min() <= spare else low
    high = finite.max() if finite.max() - high <= spare else high
    # a field that only rounding or interpolation takes below zero is not a signed one
    diverging = name in _DIVERGING or min(high, -low) > 0.02 * max(high, -low)
    if diverging:
        high = max(abs(low), abs(high))
        low = -high
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        margin = 0.5 * max(abs(high), 1e-300)
        low, high = low - margin, high + margin
    slack = 1e-9 * (high - low)
    below, above = finite.min() < low - slack, finite.max() > high + slack
    extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}
    default = "coolwarm" if diverging else "viridis"
    return _Scale(cmap or default, float(low), float(high), extend[int(below), int(above)])


def _mappable(scale: _Scale):
    from matplotlib import cm, colors

    return cm.ScalarMappable(colors.Normalize(scale.low, scale.high), scale.name)


def colours_of(surface: FineSurface, scale: _Scale | None) -> np.ndarray:
    """RGB bytes of every point; plain grey-blue without a scale."""
    if scale is None or surface.values is None:
        return np.tile(np.uint8(255 * np.array(_PLAIN)), (len(surface.points), 1))
    rgba = _mappable(scale).to_rgba(surface.values, bytes=True)
    rgba[~np.isfinite(surface.values)] = 120
    return np.ascontiguousarray(rgba[:, :3])


def images_of(
    surfaces: list[FineSurface],
    colours: list[np.ndarray],
    camera: Camera,
    edges: bool,
    pixels: int,
    renderer: str,
) -> list[np.ndarray]:
    """Images of all surfaces by the same renderer."""
    return _images(surfaces, colours, camera, edges, pixels, renderer)[1]


def _images(surfaces, colours, camera, edges, pixels, renderer):
    """Images of all surfaces by the same renderer, and its name."""
    renderers = {"pyvista": pyvista_images, "matplotlib": matplotlib_images}
    names = ["pyvista", "matplotlib"] if renderer == "auto" else [renderer]
    for name in names:
        try:
            return name, renderers[name](surfaces, colours, camera, edges, pixels)
        except PlotError:
            if name == names[-1]:
                raise
    raise AssertionError("unreachable")


def _compose(path, images, captions, title, scale, field_name, tall, dpi):
    """Images side by side under a title, an arrow between them, the colour bar at the right.

    `tall` is the part of the height of the square images that is not empty.
    """
    tall = min(max(tall, 0.5), 1.0)
    side, gap, margin = 4.6, 0.55, 0.2
    bar = 0.0 if scale is None else 1.0 if len(field_name) <= 6 else 1.3
    top = margin if title is None else 0.42 + 0.3 * len(title.splitlines())
    bottom = 0.55 if any(captions) else margin
    width = 2 * margin + len(images) * side + (len(images) - 1) * gap + bar
    height = top + tall * side + bottom
    figure = matplotlib_figure(width, height)
    page = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height), facecolor="none")
    page.set_axis_off()
    middle = bottom + 0.5 * tall * side
    for number, (image, caption) in enumerate(zip(images, captions, strict=True)):
        left = margin + number * (side + gap)
        cut = round(0.5 * (1 - tall) * len(image))
        image = image[cut : len(image) - cut]
        box = (left / width, bottom / height, side / width, tall * side / height)
        axes = figure.add_axes(box)
        axes.imshow(image, aspect="auto")
        axes.set_axis_off()
        if caption:
            at = (left + 0.5 * side, 0.55 * bottom)
            page.text(*at, caption, ha="center", va="center", size=13, color=_INK)
        if number:
            style = {"arrowstyle": "-|>,head_width=0.26,head_length=0.45", "lw": 1.6, "color": _INK}
            ends = ((left - 0.02, middle), (left - gap + 0.02, middle))
            page.annotate("", *ends, arrowprops={**style, "shrinkA": 0, "shrinkB": 0})
    if title is not None:
        centre = 0.5 * (width - bar)
        page.text(
            centre, height - 0.5 * top, title, ha="center", va="center", size=15, color=_INK,
            linespacing=1.4,
        )  # fmt: skip
    if scale is not None:
        long = 0.74 * tall * side
        box = (width - margin - bar + 0.2, middle - 0.5 * long, 0.2, long)
        axes = figure.add_axes((box[0] / width, box[1] / height, box[2] / width, box[3] / height))
        colour_bar = figure.colorbar(_mappable(scale), cax=axes, extend=scale.extend)
        colour_bar.outline.set_visible(False)
        axes.tick_params(labelsize=11, color=_INK, labelcolor=_INK, length=3)
        if len(field_name) <= 6:
            axes.set_title(field_name, size=15, pad=10, color=_INK)
        else:
            axes.set_ylabel(field_name, size=13, labelpad=8, color=_INK)
    page.set_zorder(5)
    save(figure, path, dpi)


def surface_picture(
    path: str | os.PathLike[str],
    mesh: SurfaceMesh,
    x: Nodes,
    field: Any = None,
    *,
    field_name: str = "H",
    title: str | None = None,
    caption: str | None = None,
    start: Any = None,
    start_field: Any = None,
    start_caption: str = "start",
    view: Sequence[float] | None = None,
    cmap: str | None = None,
    contour: float | None = None,
    edges: bool = True,
    dpi: float = 150.0,
    renderer: Literal["auto", "pyvista", "matplotlib"] = "auto",
) -> str:
    """Draw a surface, coloured by a field, into a PNG file.

    Elements of degree 2 to 4 are drawn curved, as they are computed. All surfaces of one picture
    share direction, scale and colours. The colour map of a signed field is centred at zero.

    PyVista draws when it is installed and works here (it needs neither a screen nor a window
    system), else matplotlib does. PyVista runs in a process of its own, because VTK takes its
    process down on a machine where it cannot draw.

    **Arguments:**

    - `field`: one number per node; None draws the shape alone.
    - `caption`, `start_caption`: a line under each surface.
    - `start`: an earlier surface to draw at the left: its nodes on the same mesh, or a pair
        (mesh, x). With it, `start_field` is its field.
    - `view`: direction from the surface to the eye, z upwards. Default: chosen from the shape.
    - `cmap`: a matplotlib colour map. Default: coolwarm for signed fields and curvatures, viridis
        for others.
    - `contour`: draw the line on which the field has this value.
    - `edges`: draw the edges of the elements.

    **Returns:** the name of the renderer used.

    **Raises:** `PlotError` when no picture can be made (nothing to draw, no renderer, no place to
    write); `ValueError` for arrays of the wrong shape.
    """
    if renderer not in ("auto", "pyvista", "matplotlib"):
        raise ValueError(f'`renderer` is "auto", "pyvista" or "matplotlib"; got {renderer!r}.')
    surfaces, captions = [fine_surface(mesh, x, field)], [caption]
    if start is not None:
        first_mesh, first_x = start if isinstance(start, tuple) else (mesh, start)
        surfaces = [fine_surface(first_mesh, first_x, start_field), *surfaces]
        captions = [start_caption, caption]
    if contour is not None:
        surfaces = [with_contour(surface, contour) for surface in surfaces]
    matplotlib_figure(1.0, 1.0)  # say at once when matplotlib is missing
    values = [s.values for s in surfaces if s.values is not None]
    scale = scale_of(values, field_name, cmap) if values else None
    camera = camera_for([s.points for s in surfaces], view)
    heights = [np.ptp(s.points @ camera.axes[1]) for s in surfaces]
    tall = float(0.06 + max(heights) / (2 * camera.half_height))
    pixels = round(4.6 * dpi)
    colours = [colours_of(surface, scale) for surface in surfaces]
    used, images = _images(surfaces, colours, camera, edges, pixels, renderer)
    _compose(path, images, captions, title, scale, field_name, tall, dpi)
    return used

"""Errors of a convergence study against the mesh size."""

import itertools
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from ._error import PlotError, matplotlib_figure, save
from ._history import _BLUE, _GREEN, _GREY, _INK, _ORANGE, _RED, _legend, _style

_COLOURS = (_BLUE, _ORANGE, _GREEN, _RED, "#7a4fa3", "#111827", "#0e9aa7", _GREY)
# Errors below this are rounding; they would only stretch the axis.
_FLOOR = 1e-14


def orders_picture(
    path: str | os.PathLike[str],
    rows: Sequence[dict[str, Any]],
    *,
    panels: Sequence[str],
    lines: str,
    order: float,
    error: str = "error",
    title: str | None = None,
    dpi: float = 130.0,
) -> None:
    """Draw errors against `h` into a PNG file, both axes logarithmic.

    **Arguments:**

    - `rows`: a table with the columns `h` and `error`, and those named below.
    - `panels`: one or two columns: a line of panels per value of the first, across for the second.
    - `lines`: the column that tells the curves of a panel apart.
    - `order`: slope of the dashed line to compare with.

    **Raises:** `PlotError` when there is nothing to draw, matplotlib is missing, or the file cannot
    be written.
    """
    rows = [row for row in rows if row.get("h") and row.get(error, 0) > _FLOOR]
    if not rows:
        raise PlotError("the study has no errors; there is nothing to draw.")
    values = [list(dict.fromkeys(row[name] for row in rows)) for name in panels]
    down, across = values if len(values) == 2 else (values[0], [None])
    names = list(dict.fromkeys(row[lines] for row in rows))
    height = 2.9 * len(down) + 1.2
    figure = matplotlib_figure(4.4 * len(across) + 2.2, height)
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    grid = figure.subplots(len(down), len(across), sharex=True, sharey=True, squeeze=False)
    for (i, first), (j, second) in itertools.product(enumerate(down), enumerate(across)):
        chosen = [first] if second is None else [first, second]
        own = [r for r in rows if [r[name] for name in panels] == chosen]
        axes = grid[i, j]
        _style(axes, "relative error" if j == 0 else "")
        axes.set_title(", ".join(str(value) for value in chosen), size=12, color=_INK)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.xaxis.set_major_locator(FixedLocator([0.8 / 2**k for k in range(8)]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        for name, colour in zip(names, itertools.cycle(_COLOURS), strict=False):
            points = [(r["h"], r[error]) for r in own if r[lines] == name]
            if points:
                axes.plot(*zip(*points, strict=True), "o-", color=colour, lw=1.6, ms=4, label=name)
        if own:
            h = np.array(sorted({r["h"] for r in own}))
            top = max(r[error] for r in own)
            axes.plot(h, 2 * top * (h / h[-1]) ** order, "--", color=_GREY, label=f"h^{order:g}")
    for axes in grid[-1]:
        axes.set_xlabel("h", size=12, color=_INK)
    _legend(grid[0, -1], loc="upper left", bbox_to_anchor=(1.02, 1.0))
    if title is not None:
        figure.suptitle(title, size=14, color=_INK)
    figure.subplots_adjust(
        left=0.95 / (4.4 * len(across) + 2.2),
        right=1 - 2.0 / (4.4 * len(across) + 2.2),
        bottom=0.6 / height,
        top=1 - 0.75 / height,
        hspace=0.25,
        wspace=0.12,
    )
    save(figure, path, dpi)

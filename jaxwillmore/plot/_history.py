"""The curves of a run: energy, geometry, steps, health of the mesh."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from ._error import PlotError, matplotlib_figure, save

_BLUE, _ORANGE, _GREEN, _RED, _GREY = "#2563a8", "#d9822b", "#2f8f6b", "#c23b3b", "#8a94a0"
_INK = "#1f2933"
_ROUNDING = 1e-13


class _Columns:
    """Rows of a history as arrays; what is missing or None is NaN."""

    def __init__(self, rows: Sequence[dict[str, Any]]):
        self.rows = rows
        self.t = self["t"]

    def __getitem__(self, name: str) -> np.ndarray:
        values = [row.get(name) for row in self.rows]
        return np.array([np.nan if v is None else float(v) for v in values])

    def __contains__(self, name: str) -> bool:
        return bool(np.any(np.isfinite(self[name])))

    @property
    def at_rest(self) -> bool:
        """Whether only a concentration changes, on a surface that does not."""
        sizes = [self[name] for name in ("area", "willmore") if name in self]
        return "phase_mean" in self and bool(sizes) and all(np.ptp(y) == 0 for y in sizes)


def _style(axes, ylabel: str) -> None:
    axes.set_ylabel(ylabel, size=12, color=_INK)
    axes.tick_params(which="both", labelsize=10.5, color=_GREY, labelcolor=_INK)
    axes.grid(True, color="#e3e7ec", lw=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(_GREY)


def _legend(axes, at_least: int = 1, **kwargs) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if len(labels) > at_least - 1:
        axes.legend(handles, labels, fontsize=10.5, frameon=False, labelcolor=_INK, **kwargs)


def _curve(axes, t, y, colour: str, label: str | None = None, dash: str = "-") -> None:
    few = np.count_nonzero(np.isfinite(y)) < 40
    axes.plot(t, y, dash, color=colour, lw=1.8, label=label, marker="o" if few else None, ms=3)


def _log(axes, *curves: np.ndarray) -> None:
    """Logarithmic values between powers of ten, or with finer numbers where there is but one."""
    y = np.concatenate(curves)
    y = y[np.isfinite(y) & (y > 0)]
    axes.set_yscale("log")
    if len(y) and y.max() > 12 * y.min():
        low, high = np.floor(np.log10(y.min()) + 1e-3), np.ceil(np.log10(y.max()) - 1e-3)
        axes.set_ylim(0.9 * 10.0**low, 1.1 * 10.0**high)
        from matplotlib.ticker import NullFormatter

        axes.yaxis.set_minor_formatter(NullFormatter())


def _log_if_wide(axes, *curves: np.ndarray, factor: float = 30.0) -> None:
    """Logarithmic values where they are positive and span more than `factor`."""
    y = np.concatenate(curves)
    y = y[np.isfinite(y)]
    if len(y) and y.min() > 0 and y.max() > factor * y.min():
        _log(axes, y)


def _energy(axes, data: _Columns, reference: dict[str, float]) -> None:
    _style(axes, "energy")
    energy = data["energy"]
    _curve(axes, data.t, energy, _BLUE, "energy")
    other = data["willmore"]
    shown = [energy]
    if (
        "willmore" in data
        and not data.at_rest
        and not np.allclose(other, energy, rtol=0.02, equal_nan=True)
    ):
        _curve(axes, data.t, other, _ORANGE, "½∫H² from x", "--")
        shown.append(other)
    for name, value in reference.items():
        axes.axhline(value, color=_GREY, lw=1.2, ls=(0, (4, 3)))
        axes.annotate(
            name, (1.0, value), xycoords=("axes fraction", "data"), xytext=(-4, 4),
            textcoords="offset points", ha="right", va="bottom", size=11.5, color=_INK,
        )  # fmt: skip
    _log_if_wide(axes, *shown)
    _legend(axes, at_least=2, loc="upper right")


def _excess(axes, data: _Columns, reference: dict[str, float]) -> None:
    """How far the energy still is above the reference, or how far the two energies differ."""
    x_energy, field_energy = data["willmore"], data["willmore_of_field"]
    if reference:
        name, value = min(reference.items(), key=lambda item: abs(item[1] - x_energy[-1]))
        curves = [
            (np.abs(x_energy - value), _BLUE, "½∫H² from x", "-"),
            (np.abs(field_energy - value), _ORANGE, "½∫H² from the field H", "--"),
        ]
        _style(axes, f"| ½∫H² − {name} |")
    else:
        curves = [(np.abs(field_energy - x_energy), _BLUE, None, "-")]
        _style(axes, "| ½∫H² of field − of x |")
    for y, colour, label, dash in curves:
        y = np.where(y > 0, y, np.nan)
        if np.any(np.isfinite(y)):
            _curve(axes, data.t, y, colour, label, dash)
            _log(axes, y)
    _legend(axes, loc="best")


def _measures(axes, data: _Columns) -> None:
    _style(axes, "area, volume (start = 1)")
    for name, colour in (("area", _BLUE), ("volume", _ORANGE)):
        y = data[name]
        known = y[np.isfinite(y)]
        if len(known) and known[0] != 0:
            _curve(axes, data.t, y / known[0], colour, name)
    if "reduced_volume" in data:
        _curve(axes, data.t, data["reduced_volume"], _GREEN, "reduced volume", "--")
    _legend(axes, loc="best")


def _parts(axes, data: _Columns) -> None:
    """The energies of a two-phase membrane, one on top of the other; a negative one as a curve."""
    _style(axes, "parts of the energy")
    bottom = np.zeros(len(data.t))
    for name, colour, label in (
        ("phase_energy_bending", _BLUE, "bending"),
        ("phase_energy_phase", _ORANGE, "phases"),
        ("phase_energy_gaussian", _GREEN, "Gaussian"),
    ):
        y = data[name]
        if not np.any(np.abs(y) > 0):
            continue
        if np.nanmin(y) < 0:
            _curve(axes, data.t, y, colour, label, "--")
            continue
        axes.fill_between(data.t, bottom, bottom + y, color=colour, alpha=0.45, lw=0, label=label)
        bottom = bottom + y
    _legend(axes, loc="upper right")


def _domains(axes, data: _Columns) -> None:
    _style(axes, "interfaces")
    length, count = data["phase_interface_length"], data["phase_domains"]
    _curve(axes, data.t, np.where(length > 0, length, np.nan), _BLUE, "length of c = ½")
    _curve(axes, data.t, np.where(count > 0, count, np.nan), _ORANGE, "domains with c > ½")
    shown = np.concatenate([length, count])
    if np.any(shown > 0):
        _log(axes, shown)
    _legend(axes, loc="best")


def _extremes(axes, data: _Columns) -> None:
    _style(axes, "concentration")
    _curve(axes, data.t, data["phase_smallest"], _BLUE, "smallest")
    _curve(axes, data.t, data["phase_mean"], _GREEN, "mean")
    _curve(axes, data.t, data["phase_largest"], _ORANGE, "largest")
    for value in (0.0, 1.0):
        axes.axhline(value, color=_GREY, lw=1.2, ls=(0, (4, 3)))
    _legend(axes, loc="best")


def after_rejections(total: np.ndarray) -> np.ndarray:
    """The rows at which the number of rejected attempts so far has grown."""
    return np.flatnonzero(np.diff(total, prepend=0.0) > 0)


def _steps(axes, data: _Columns) -> None:
    _style(axes, "step size")
    dt = data["dt"]
    rejected = data["rejected_steps"]
    counts = data["newton_iterations"]
    if "newton_iterations" in data:
        other = axes.twinx()
        other.plot(data.t, counts, ".", color=_ORANGE, ms=4.5, alpha=0.55)
        other.set_ylabel("Newton iterations", size=12, color=_ORANGE)
        other.set_ylim(0, 2.5 * max(float(np.nanmax(counts)), 2.0))
        other.yaxis.get_major_locator().set_params(integer=True)
        other.tick_params(labelsize=10.5, color=_ORANGE, labelcolor=_ORANGE)
        for side in ("top", "left"):
            other.spines[side].set_visible(False)
        other.spines["right"].set_color(_ORANGE)
        axes.set_zorder(other.get_zorder() + 1)
        axes.patch.set_visible(False)
    _curve(axes, data.t, np.where(dt > 0, dt, np.nan), _BLUE, None)
    hit = after_rejections(rejected)
    if len(hit):
        axes.plot(
            data.t[hit], dt[hit], "x", color=_RED, ms=7, mew=1.8, label="after a rejected step"
        )
    _log_if_wide(axes, dt[dt > 0], factor=8.0)
    _legend(axes, loc="lower right")


def _angles(axes, data: _Columns) -> None:
    _style(axes, "angles of the elements (°)")
    _curve(axes, data.t, data["min_angle"], _BLUE, "smallest")
    _curve(axes, data.t, data["max_angle"], _ORANGE, "largest")
    axes.axhline(60.0, color=_GREY, lw=1.2, ls=(0, (4, 3)))
    both = np.concatenate([data["min_angle"], data["max_angle"]])
    low, high = np.nanmin(both), np.nanmax(both)
    axes.set_ylim(0.8 * low if low > 20 else 0.0, min(180.0, 1.25 * max(high, 60.0)))
    _legend(axes, loc="best", ncols=2)


def _normals(axes, data: _Columns) -> None:
    _style(axes, "defects of the normal")
    shown = []
    for name, colour, label in (
        ("normal_length_defect", _BLUE, "max | |ν| − 1 |"),
        ("normal_distance", _ORANGE, "‖ν − normal of x‖"),
    ):
        y = data[name]
        # Interpolated initial fields have no defect but rounding.
        y = np.where(y > _ROUNDING, y, np.nan)
        if np.any(np.isfinite(y)):
            _curve(axes, data.t, y, colour, label)
            shown.append(y)
    if shown:
        _log(axes, *shown)
    _legend(axes, loc="best")


def _time_axis(figure_axes, t: np.ndarray, coarsens: bool) -> None:
    """Logarithmic when most steps were taken in the first twentieth of the time, or it coarsens."""
    later = t[t > 0]
    early = len(later) > 3 and later[0] < 0.01 * later[-1]
    early = early and (coarsens or np.median(later) < 0.05 * later[-1])
    for axes in figure_axes:
        if early:
            axes.set_xscale("log")
            axes.set_xlim(later[0], later[-1])
        elif len(t) > 1 and t[-1] > t[0]:
            axes.set_xlim(t[0], t[-1])


def history_picture(
    path: str | os.PathLike[str],
    rows: Sequence[dict[str, Any]],
    *,
    reference: dict[str, float] | None = None,
    title: str | None = None,
    dpi: float = 130.0,
) -> None:
    """Draw the history of a run into a PNG file: six panels over time, nine with a concentration.

    Energy; its distance from a reference value; area, volume and reduced volume; step size with
    Newton iterations; angles of the elements; defects of the normal field; parts of the energy,
    interfaces and extremes of a concentration. Panels whose numbers are not in the rows are left
    out, and those of geometry and bending where the surface is at rest.

    **Arguments:**

    - `rows`: one dictionary per step, as in `history.csv` (`jaxwillmore.io.read_history`).
        `rejected_steps` counts all attempts that were rejected so far.
    - `reference`: name -> value of ½∫H² to compare with, for example `{"8π": 8 * math.pi}`.

    **Raises:** `PlotError` when there are no rows, matplotlib is missing, or the file cannot be
    written.
    """
    data = _Columns(rows)
    if "t" not in data:
        raise PlotError("the history has no steps; there is nothing to draw.")
    reference = {} if reference is None or data.at_rest else reference
    panels = [
        (_energy, ("energy",), (data, reference)),
        (_excess, ("willmore", "willmore_of_field"), (data, reference)),
        (_measures, ("area", "volume", "reduced_volume"), (data,)),
        (_steps, ("dt",), (data,)),
        (_angles, ("min_angle", "max_angle"), (data,)),
        (_normals, ("normal_length_defect", "normal_distance"), (data,)),
        (_parts, ("phase_energy_phase",), (data,)),
        (_domains, ("phase_interface_length",), (data,)),
        (_extremes, ("phase_mean",), (data,)),
    ]
    panels = [
        (draw, inputs)
        for draw, names, inputs in panels
        if any(name in data for name in names)
        and not (data.at_rest and draw in (_excess, _measures, _angles, _normals, _parts))
    ]
    if not panels:
        raise PlotError("the history has none of the columns that are drawn.")
    n_lines = -(-len(panels) // 2)
    height = 2.9 * n_lines + (0.9 if title else 0.4)
    figure = matplotlib_figure(12.5, height)
    grid = figure.subplots(n_lines, 2 if len(panels) > 1 else 1, sharex=True, squeeze=False)
    flat = grid.ravel()
    for axes, (draw, inputs) in zip(flat, panels, strict=False):
        draw(axes, *inputs)
    for axes in flat[len(panels) :]:
        axes.set_axis_off()
    _time_axis(flat[: len(panels)], data.t, "phase_mean" in data)
    for axes in flat[max(0, len(panels) - 2) : len(panels)]:
        axes.set_xlabel("time", size=12, color=_INK)
        axes.tick_params(labelbottom=True)
    if title is not None:
        figure.suptitle(title, size=15, color=_INK, y=1 - 0.32 / height)
    figure.subplots_adjust(
        left=0.075, right=0.93, bottom=0.62 / height, top=1 - (0.75 if title else 0.25) / height,
        hspace=0.16, wspace=0.3,
    )  # fmt: skip
    figure.align_ylabels(grid)
    save(figure, path, dpi)

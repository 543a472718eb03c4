"""Run a fit: parameters of equilibria from observed surfaces, and a folder full of results."""

import dataclasses
import json
import os
import pathlib
import time
import warnings
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from .. import fit as fits
from .._interrupts import catch_interrupts, interrupted
from ..equilibria import smoothed
from ..io import RunFolder, atomic_write, read_surface, write_npz
from ..mesh import raise_degree
from ..plot import PlotError, overlay_picture, profile_picture, surface_picture
from ._error import CaseError
from ._examples import example_path, is_example
from ._fit_case import FitTask

ITERATE = "iterate.json"
# A profile reaches this many standard errors to either side, but no further than this.
PROFILE_WIDTH, PROFILE_MOST, PROFILE_POINTS = 3.0, 0.5, 9


@dataclasses.dataclass(frozen=True)
class FitRun:
    """A finished fit: its folder and what `summary.json` says."""

    folder: pathlib.Path
    summary: dict[str, Any]

    @property
    def succeeded(self) -> bool:
        """Whether parameters were found that the data determine."""
        return self.summary["status"] == "converged"


@catch_interrupts()
def run_fit(
    task: FitTask,
    out: str | os.PathLike[str],
    *,
    existing: Literal["refuse", "replace", "resume"] = "refuse",
    progress: Callable[[dict[str, Any]], None] | None = None,
) -> FitRun:
    """Fit, and leave case, history, iterate, surfaces, summary and pictures in a folder.

    `iterate.json` is written after every step. With `existing="resume"` a fit goes on from it.
    Ctrl-C or SIGTERM end the fit after the step in progress, a second signal at once.

    **Raises:** `CaseError` for a case that makes no sense; `RunFolderError` for a folder that
    cannot be used; what `jaxwillmore.io.read_surface` raises for a mesh file.
    """
    began = time.perf_counter()
    targets = [_target(task, file) for file in task.target.file]
    pathlib.Path(out).parent.mkdir(parents=True, exist_ok=True)
    with RunFolder(out, existing) as folder:
        folder.write_text("case.toml", task.to_toml())
        run = _match if task.fit.method == "match" else _balance
        try:
            summary = run(task, targets, folder, existing == "resume", progress)
        except ValueError as error:
            if isinstance(error, CaseError):
                raise
            raise CaseError(str(error), section="fit") from error
        summary["wall_seconds"] = time.perf_counter() - began
        folder.write_summary(summary)
    return FitRun(folder.path, summary)


def _target(task: FitTask, file: str):
    source = example_path(file) if is_example(file) else file
    return read_surface(source, fix_orientation=task.target.fix_orientation)


def _match(task: FitTask, targets, folder: RunFolder, resume: bool, progress) -> dict[str, Any]:
    model, fit = task.model, task.fit
    start = {"spontaneous_curvature": model.spontaneous_curvature}
    start |= {} if model.reduced_volume is None else {"reduced_volume": model.reduced_volume}
    start |= {} if model.pressure is None else {"pressure": model.pressure}
    bounds = {
        name: value
        for name, value in (
            ("reduced_volume", fit.reduced_volume_bounds),
            ("spontaneous_curvature", fit.spontaneous_curvature_bounds),
        )
        if value is not None
    }

    def seen(row: dict[str, float], iterate: fits.MatchIterate) -> None:
        folder.append_history(row)
        with atomic_write(folder.file(ITERATE), "w") as file:
            json.dump(iterate.to_json(), file)
        if progress is not None:
            progress(row)

    found = fits.match_shapes(
        targets,
        free=fit.free,
        shared=fit.shared,
        start=start,
        kind=model.kind,
        bounds=bounds,
        level=model.level,
        both_ways=fit.both_ways,
        noise=fit.noise,
        tolerance=fit.tolerance,
        max_steps=fit.max_steps,
        resume=_iterate(folder) if resume else None,
        throw=False,
        observer=seen,
    )
    for k, shape in enumerate(found.shapes):
        write_npz(folder.file(f"final_{k}.npz"), shape.mesh, shape.x)
    if fit.picture and found.shapes:
        _draw_match(folder, targets, found)
    return _match_summary(found)


def _iterate(folder: RunFolder) -> fits.MatchIterate:
    path = folder.file(ITERATE)
    try:
        return fits.MatchIterate.from_json(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise CaseError(f"there is no fit to resume: `{path}` does not exist.") from None
    except ValueError as error:
        raise CaseError(f"`{path}` cannot be read: {error}") from error


def _match_summary(found: fits.ShapeFit) -> dict[str, Any]:
    return {
        "status": fits.name_of(found.result),
        "message": fits.message(found.result),
        "shapes": [
            {
                "parameters": shape.parameters,
                "standard_errors": shape.errors,
                "distances": shape.distances,
            }
            for shape in found.shapes
        ],
        "rms_over_R0": found.rms,
        "on_bound": list(found.on_bound),
        **_identification(found.identification, found.robust),
        "in_words": list(found.in_words()),
        **found.stats,
    }


def _identification(found: fits.Identification, robust: fits.Identification | None):
    told = found.identifiable
    table = {
        "free": list(found.names),
        "identifiable": told,
        "intervals_95": {n: i for n, i in found.intervals().items() if told[n]},
        "singular_values": found.singular_values.tolist(),
        "directions": found.directions.tolist(),
        "null_directions": list(found.null_directions),
        "correlation": found.correlation.tolist(),
    }
    if robust is not None:
        intervals = {n: i for n, i in robust.intervals().items() if told[n]}
        table["intervals_95_dependent_residuals"] = intervals
    return table


def _draw_match(folder: RunFolder, targets, found: fits.ShapeFit) -> None:
    """Pictures are a help: a fit without them is a good fit, and says so."""
    status = fits.name_of(found.result).replace("_", " ")
    try:
        for k, ((mesh, x), shape) in enumerate(zip(targets, found.shapes, strict=True)):
            p, rms = shape.parameters, shape.distances["rms"]
            words = f"v = {p['reduced_volume']:.4f},  H0·R0 = {p['spontaneous_curvature']:.3f}"
            title = f"{status}: {words},  R0 = {p['radius']:.4g},  rms distance {rms:.3g}"
            model = shape.mesh, shape.x
            overlay_picture(folder.file(f"overlay_{k}.png"), (mesh, x), model, title=title)
            surface_picture(
                folder.file(f"residual_{k}.png"),
                mesh,
                x,
                shape.residual,
                field_name="distance",
                caption=f"target: distance from the fit (rms {rms:.3g})",
                edges=False,
            )
        profiles, best = _profiles(found)
        if profiles:
            ylabel = "rms residual / that of the fit"
            profile_picture(folder.file("profile.png"), profiles, best, ylabel=ylabel)
    except PlotError as error:
        warnings.warn(f"no picture: {error}", UserWarning, stacklevel=2)


def _profiles(found: fits.ShapeFit):
    """Values and misfits of every parameter that the data determine."""
    profiles, best = {}, {}
    layout, told = found.residuals.unknowns, found.identification.identifiable
    for k, label in enumerate(layout.labels):
        if interrupted():  # a profile is as much work as several fits
            return {}, {}
        error = found.robust.standard_errors[label]
        if not told[label] or not error > 0:
            continue
        middle = float(found.identification.values[k])
        width = min(PROFILE_WIDTH * error, PROFILE_MOST)
        offsets = width * np.linspace(-1.0, 1.0, PROFILE_POINTS)
        values = [middle + d for d in offsets if _allowed(layout.ranges[k], middle + d)]
        profiles[label] = np.array(values), fits.profile(found, label, np.array(values))
        best[label] = middle
    return profiles, best


def _allowed(values: fits.AbstractRange, value: float) -> bool:
    try:
        values.unknown(value)
    except ValueError:
        return False
    return True


def _balance(task: FitTask, targets, folder: RunFolder, resume: bool, progress) -> dict[str, Any]:
    if resume:
        raise CaseError('a fit by "force-balance" has no steps to resume.', section="fit")
    surfaces = [(m, x) if m.degree > 1 else _lifted(m, x) for m, x in targets]
    known = {} if "spontaneous_curvature" in task.fit.free else {"spontaneous_curvature": 0.0}
    if known and task.model.spontaneous_curvature != 0.0:
        problem = 'a held value other than 0 is for method = "match".'
        raise CaseError(problem, section="model", key="spontaneous_curvature")
    shared = [name for name in task.fit.shared if name != "reduced_volume"]
    found = fits.force_balance(surfaces, known=known, shared=shared, noise=task.fit.noise)
    for k, ((mesh, x), field) in enumerate(zip(surfaces, found.residuals, strict=True)):
        write_npz(folder.file(f"final_{k}.npz"), mesh, x, {"residual": field})
        if task.fit.picture:
            _draw_balance(folder, k, mesh, x, field, found.unexplained)
    told = found.identification.identifiable
    return {
        "status": "converged" if all(told.values()) else "not_identifiable",
        "message": fits.message(
            fits.RESULTS.converged if all(told.values()) else fits.RESULTS.not_identifiable
        ),
        "parameters": list(found.parameters),
        "unexplained": found.unexplained,
        **_identification(found.identification, None),
        "in_words": list(found.in_words()),
    }


def _lifted(mesh, x):
    """Triangles raised to degree 2, without their facets."""
    mesh, x = raise_degree(mesh, x, 2)
    return mesh, smoothed(mesh, x)


def _draw_balance(folder: RunFolder, k: int, mesh, x, field, unexplained: float) -> None:
    try:
        surface_picture(
            folder.file(f"residual_{k}.png"),
            mesh,
            x,
            field,
            field_name="displacement",
            caption=f"force that no parameters explain: {100 * unexplained:.3g} %",
            edges=False,
        )
    except PlotError as error:
        warnings.warn(f"no picture: {error}", UserWarning, stacklevel=2)

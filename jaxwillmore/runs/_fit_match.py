"""Shape matching as a case asks for it."""

from typing import Any

import numpy as np

from .. import fit as fits
from ..cases import FitTask
from ..io import RunFolder, write_npz
from ._fit_iterate import read_iterate, write_iterate
from ._fit_pictures import draw_profiles, draw_shape, warned_only
from ._fit_summary import ending, identification, verdict_of


def match(task: FitTask, targets, folder: RunFolder, resume: bool, progress) -> dict[str, Any]:
    """Fit equilibria by distance; the summary."""
    model, fit = task.model, task.fit
    start = {"scaled_spontaneous_curvature": model.scaled_spontaneous_curvature}
    start |= {} if model.reduced_volume is None else {"reduced_volume": model.reduced_volume}
    if model.scaled_pressure is not None:
        start["scaled_pressure"] = model.scaled_pressure
    bounds = {
        name: value
        for name, value in (
            ("reduced_volume", fit.reduced_volume_bounds),
            ("scaled_spontaneous_curvature", fit.scaled_spontaneous_curvature_bounds),
        )
        if value is not None
    }

    def seen(row: dict[str, float], iterate: fits.MatchIterate) -> None:
        folder.append_history(row)
        write_iterate(folder, iterate.to_json())
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
        distance=fit.distance,
        max_degree=fit.max_degree,
        both_ways=fit.both_ways if fit.distance == "points" else None,
        noise=fit.noise,
        tolerance=fit.tolerance,
        max_steps=fit.max_steps,
        resume=read_iterate(folder, fits.MatchIterate.from_json) if resume else None,
        throw=False,
        observer=seen,
    )
    for k, shape in enumerate(found.shapes):
        write_npz(folder.file(f"final_{k}.npz"), shape.mesh, shape.x)
    if fit.picture and found.shapes:
        _draw(folder, targets, found)
    return _summary(found)


def _summary(found: fits.ShapeFit) -> dict[str, Any]:
    by_mesh = fits.mesh_errors(found) if found.succeeded else {}
    return {
        **ending(found.result),
        **verdict_of(found.verdict, _coarse_words(found, by_mesh)),
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
        **identification(found.identification, found.robust),
        "mesh_errors": by_mesh,
        "in_words": [*found.in_words(), *_coarse_words(found, by_mesh)],
        **found.stats,
    }


def _draw(folder: RunFolder, targets, found: fits.ShapeFit) -> None:
    status = found.verdict.word
    with warned_only():
        for k, (target, shape) in enumerate(zip(targets, found.shapes, strict=True)):
            p, rms = shape.parameters, shape.distances["rms"]
            words = (
                f"v = {p['reduced_volume']:.4f},  H0·R0 = {p['scaled_spontaneous_curvature']:.3f}"
            )
            title = f"{status}: {words},  R0 = {p['radius']:.4g},  rms distance {rms:.3g}"
            draw_shape(folder, k, target, (shape.mesh, shape.x), shape.residual, title, rms)
        draw_profiles(folder, found, found.robust.standard_errors)


def _coarse_words(found: fits.ShapeFit, by_mesh: dict[str, float]) -> list[str]:
    """Of parameters that the mesh moves by more than the errors of the data do."""
    if not np.all(np.isfinite(list(by_mesh.values()))):
        return [
            "How far the mesh of the model moves the parameters is not known: a coarser one has no "
            "such equilibrium. Compare with a larger `level`."
        ]
    errors = found.robust.standard_errors
    return [
        f"The mesh of the model alone may move {label} by {error:.2g}, more than its standard "
        f"error ({errors[label]:.2g}); a finer one is had by a larger `level`."
        for label, error in by_mesh.items()
        if error > errors[label]
    ]

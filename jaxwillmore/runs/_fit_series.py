"""A fit to a time series as a case asks for it."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .. import fit as fits
from ..cases import FLOW_PARAMETERS, CaseError, FitTask, FlowModelCase
from ..energies import Pressure, SurfaceTension
from ..flows import AbstractLaw, Loads, MinimalDeformation, System, WillmoreFlow
from ..io import RunFolder, write_npz
from ..mesh import SurfaceMesh
from ..surface import area, volume
from ._fit_iterate import read_iterate, write_iterate
from ._fit_pictures import draw_profiles, draw_shape, warned_only
from ._fit_summary import ending, identification, verdict_of

LOADS = (("tension", SurfaceTension), ("pressure", Pressure))


@dataclasses.dataclass(frozen=True)
class FlowOfCase:
    """From free parameters by name to the flow of a case; equal ones share compiled code.

    **Attributes:**

    - `free`: names of the parameters that are given in a call.
    - `case`: the section `[flow]`, with the values of the others.
    - `fixed_area`, `fixed_volume`: what is held, or `None`.
    """

    free: tuple[str, ...]
    case: FlowModelCase
    fixed_area: float | None
    fixed_volume: float | None

    def __call__(self, free: dict[str, Float[Array, ""]]) -> System:
        p = {name: getattr(self.case, name) for name in FLOW_PARAMETERS} | free
        law: dict[str, Any] = {name: p[name] for name in FLOW_PARAMETERS[:2]}
        laws: list[AbstractLaw] = [WillmoreFlow(**law)]
        loads = None
        for name, kind in LOADS:
            if name in self.free or getattr(self.case, name):
                loads = kind(p[name]) if loads is None else loads + kind(p[name])
        if not (loads is None and self.fixed_area is None and self.fixed_volume is None):
            laws.append(Loads(loads, area=self.fixed_area, volume=self.fixed_volume))
        if self.case.tangential == "minimal-deformation":
            laws.append(MinimalDeformation())
        return System(*laws)


def series(task: FitTask, surfaces, folder: RunFolder, resume: bool, progress) -> dict[str, Any]:
    """Fit parameters of a flow to surfaces at known times; the summary."""
    assert task.target.times is not None
    fit, times = task.fit, list(task.target.times)
    checked = _checked(task, surfaces)
    t0 = times.pop(0) if task.target.start is None else 0.0
    (mesh, x), *observations = checked
    held = {
        "fixed_area": float(area(mesh, x)) if "area" in task.flow.hold else None,
        "fixed_volume": float(volume(mesh, x)) if "volume" in task.flow.hold else None,
    }
    start = {name: getattr(task.flow, name) for name in fit.free}
    if resume:
        start = read_iterate(folder, lambda tables: _parameters(tables, fit.free))
    write_iterate(folder, {"parameters": start})
    bounds = fit.spontaneous_curvature_bounds
    ranges = {} if bounds is None else {"spontaneous_curvature": fits.Between(*bounds)}

    def seen(row: dict[str, float]) -> None:
        folder.append_history(row)
        write_iterate(folder, {"parameters": {name: row[name] for name in fit.free}})
        if progress is not None:
            progress(row)

    found = fits.fit_flow(
        FlowOfCase(fit.free, task.flow, **held),
        mesh,
        x,
        times,
        observations,
        start=start,
        ranges={name: allowed for name, allowed in ranges.items() if name in fit.free},
        t0=t0,
        rtol=fit.rtol,
        noise=fit.noise,
        tolerance=fit.tolerance,
        max_steps=fit.max_steps,
        throw=False,
        observer=seen,
    )
    shapes = found.shapes() if _is_complete(found) else ()
    for k, shape in enumerate(shapes):
        write_npz(folder.file(f"final_{k}.npz"), shape.mesh, shape.x)
    if fit.picture and shapes:
        _draw(folder, observations, shapes, found)
    return _summary(found, shapes, fit.noise)


def _is_complete(found: fits.FlowFit) -> bool:
    """Whether there is a solution to look at, and nobody waits for the end."""
    return bool(np.isfinite(found.rms)) and not bool(found.result == fits.RESULTS.interrupted)


def _checked(task: FitTask, surfaces) -> list[tuple[SurfaceMesh, Any]]:
    """The surfaces of a series, the start first, each of them closed, finite and outward."""
    target, checked = task.target, []
    files = target.file if target.start is None else (target.start, *target.file)
    for file, (mesh, x) in zip(files, surfaces, strict=True):
        try:
            checked.append(fits.checked_surface(mesh, x))
        except ValueError as error:
            problem = f"{file}: {error}"
            raise CaseError(problem, section="target", key="file") from None
        cells = checked[0][0].cells
        if target.same_mesh and not np.array_equal(mesh.cells, cells):
            problem = (
                f"{file} has other triangles than {files[0]}. If each surface was triangulated by "
                "itself, write same_mesh = false: only distances between surfaces are compared."
            )
            raise CaseError(problem, section="target", key="file")
    return checked


def _parameters(tables: Any, free: tuple[str, ...]) -> dict[str, float]:
    try:
        found = {name: float(tables["parameters"][name]) for name in free}
    except (KeyError, TypeError) as error:
        raise ValueError(f"it has no values of {', '.join(free)}: {error!r}.") from error
    if not all(map(np.isfinite, found.values())):
        raise ValueError(f"its values are not finite: {found}.")
    return found


def _summary(found: fits.FlowFit, shapes: tuple[fits.SeenShape, ...], noise) -> dict[str, Any]:
    verdict = found.judged(noise, shapes)
    return {
        **ending(found.result),
        **verdict_of(verdict),
        "parameters": found.parameters,
        "standard_errors": found.identification.standard_errors,
        "shapes": [{"time": shape.time, "distances": shape.distances} for shape in shapes],
        "rms_over_R0": found.rms,
        **identification(found.identification),
        "in_words": [verdict.sentence, *found.in_words()],
        **found.stats,
    }


def _draw(folder: RunFolder, targets, shapes, found: fits.FlowFit) -> None:
    status = fits.name_of(found.result).replace("_", " ")
    words = ",  ".join(f"{name} = {value:.4g}" for name, value in found.parameters.items())
    with warned_only():
        for k, (target, shape) in enumerate(zip(targets, shapes, strict=True)):
            rms = shape.distances["rms"]
            title = f"{status}: {words},  t = {shape.time:.4g},  rms distance {rms:.3g}"
            draw_shape(folder, k, target, (shape.mesh, shape.x), shape.residual, title, rms)
        draw_profiles(folder, found, found.identification.standard_errors)

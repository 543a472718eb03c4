"""The surface a case starts from."""

import warnings
from typing import NamedTuple

from jaxtyping import Array

from .._types import Nodes
from ..cases import Case, CaseError, SurfaceCase, example_path, is_example
from ..io import Reading, SurfaceWarning, examine_surface, raised
from ..mesh import SurfaceMesh, quality, refine
from ..shapes import make_shape
from ._phase import starting_concentration
from ._smooth import smooth_surface, without_answered


class Start(NamedTuple):
    """A surface, and the fields on it for which a formula is known."""

    mesh: SurfaceMesh
    x: Nodes
    initial: dict[str, Array]
    repairs: tuple[str, ...] = ()
    """What was done to a surface from a file before it could be used."""


def starting_surface(case: Case) -> Start:
    """Make or read the surface of a case.

    **Raises:** `CaseError` for parameters that give no surface, and for a spontaneous curvature
    that the mesh cannot resolve; what `jaxwillmore.io.read_surface` raises for a mesh file.
    """
    start = _from_shape(case.surface) if case.surface.file is None else _from_file(case.surface)
    _check_resolution(case, start)
    if case.phase is None:
        return start
    c = starting_concentration(case, start.mesh, start.x)
    return start._replace(initial=start.initial | {"c": c})


def _from_shape(surface: SurfaceCase) -> Start:
    assert surface.shape is not None and surface.level is not None
    try:
        mesh, x, exact = make_shape(
            surface.shape, level=surface.level, degree=surface.degree, **surface.parameters
        )
    except ValueError as error:
        raise CaseError(str(error), section="surface") from error
    return Start(mesh, x, {"H": exact.mean_curvature(x), "nu": exact.normal(x)})


def _from_file(surface: SurfaceCase) -> Start:
    assert surface.file is not None and surface.level is not None
    source = example_path(surface.file) if is_example(surface.file) else surface.file
    options = {
        "merge_tolerance": surface.merge_tolerance,
        "fix_orientation": surface.fix_orientation,
        "repair": surface.repair,
        "keep": surface.keep,
        "components": surface.components,
        "genus": surface.genus,
    }
    if surface.smooth is not None:
        reading = without_answered(examine_surface(source, degree=1, **options))
        warn_of(reading)
        mesh, x, act = smooth_surface(
            reading,
            surface.smooth,
            surface.wavelength,
            level=surface.level,
            degree=surface.degree,
            section=surface.name,
        )
        return Start(mesh, x, {}, (*reading.repairs, act))
    reading = examine_surface(source, **options)
    if reading.mesh.degree > surface.degree:
        reading = examine_surface(source, degree=surface.degree, **options)
    mesh, x = reading.mesh, reading.x
    for _ in range(surface.level):
        mesh, x = refine(mesh, x)
    mesh, x, report = raised(mesh, x, surface.degree, reading.report)
    warn_of(reading._replace(report=report))
    return Start(mesh, x, {}, reading.repairs)


def warn_of(reading: Reading) -> None:
    """Tell repairs and findings."""
    for act in reading.repairs:
        warnings.warn(f"{reading.name}: repaired: {act}.", SurfaceWarning, stacklevel=5)
    for finding in reading.report.warnings:
        warnings.warn(f"{reading.name}: {finding}", SurfaceWarning, stacklevel=5)


def _check_resolution(case: Case, start: Start) -> None:
    """Radii of curvature below the distance of nodes are not resolved by any mesh."""
    section, H0 = "energy", case.energy.spontaneous_curvature
    if case.phase is not None and case.phase.spontaneous_curvature is not None:
        section, H0 = "phase", max(case.phase.spontaneous_curvature, key=abs)
    spacing = quality(start.mesh, start.x).h_max / start.mesh.degree
    if abs(H0) * spacing > 1:
        allowed = f"between -{1 / spacing:.4g} and {1 / spacing:.4g}"
        problem = (
            f"must be {allowed} on this mesh, whose nodes are {spacing:.3g} apart; got {H0}. "
            "Raise `level` or `degree`."
        )
        key = "spontaneous_curvature"
        raise CaseError(problem, section=section, key=key, got=H0, allowed=allowed)

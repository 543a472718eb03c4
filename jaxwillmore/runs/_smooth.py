"""Measured surfaces smoothed as a case asks for it, for runs and for targets of fits."""

from typing import NamedTuple

import numpy as np

from .._types import Nodes
from ..cases import FAIRING, HARMONICS, CaseError
from ..io import Reading
from ..mesh import SurfaceMesh, refine
from ..surface import smoothed, spherical

# Warnings on a surface that smoothing answers.
ANSWERED = ("noise", "few_digits")


class Smooth(NamedTuple):
    """A surface, and a sentence on how it was made of the one that was read."""

    mesh: SurfaceMesh
    x: Nodes
    act: str


def smooth_surface(
    reading: Reading,
    smooth: str,
    wavelength: float | None,
    *,
    level: int,
    degree: int,
    section: str,
) -> Smooth:
    """The smooth surface of what was read with degree 1.

    **Arguments:**

    - `level`: of the icosphere for harmonics, uniform refinements of the new mesh otherwise.
    - `section`: of the case that asks, for its errors.

    **Raises:** `CaseError` where the surface has no such smooth one.
    """
    triangles = np.asarray(reading.mesh.triangles)
    try:
        if smooth == HARMONICS:
            found = spherical(reading.x, triangles, level=level, degree=degree)
            return Smooth(*found, f"smoothed {found.in_words()}")
        faired = smoothed(reading.x, triangles, wavelength, degree=degree)
    except ValueError as error:
        raise CaseError(
            f"{reading.name}: {error}{_other_way(smooth, reading)}",
            section=section,
            key="smooth" if wavelength is None else "wavelength",
            got=smooth if wavelength is None else wavelength,
        ) from error
    mesh, x = faired
    for _ in range(level):
        mesh, x = refine(mesh, x)
    return Smooth(mesh, x, f"smoothed {faired.in_words()}")


def without_answered(reading: Reading) -> Reading:
    """The reading without the warnings that ask for what is done."""
    left = tuple(f for f in reading.report.findings if f.kind not in ANSWERED)
    return reading._replace(report=reading.report._replace(findings=left))


def _other_way(smooth: str, reading: Reading) -> str:
    if smooth == HARMONICS and reading.mesh.genus != 0:
        return f' With handles: smooth = "{FAIRING}".'
    return ""

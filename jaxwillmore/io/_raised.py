"""From flat triangles to curved ones, with a word on how far that moves area and volume."""

import equinox as eqx
import numpy as np

from ..mesh import Finding, SurfaceReport, creases, raise_degree
from ..surface import area, volume

# Larger changes of area or volume are no smoothing of a fine mesh.
LARGE_CHANGE = 0.03
_SMOOTH = (
    'Smooth a measured surface (in a case smooth = "harmonics" or "fairing", in Python '
    "`surface.spherical` or `surface.smoothed`)"
)


def raised(mesh, x, degree: int, report: SurfaceReport):
    """A flat triangulation with curved triangles through its vertices, and the report on it.

    A finding is added where there are creases, and where area or volume change by more than 3 %.
    """
    if degree == mesh.degree:
        return mesh, x, report
    report = _with_creases(mesh, x, degree, report)
    before = _measures(mesh, x)
    new, new_x = raise_degree(mesh, x, degree)
    changes = [float(b / a) - 1 for a, b in zip(before, _measures(new, new_x), strict=True)]
    if max(abs(change) for change in changes) <= LARGE_CHANGE:
        return new, new_x, report
    finding = Finding(
        "moved_by_degree",
        "warning",
        len(mesh.cells),
        (),
        f"Curved triangles of degree {degree} through the vertices change the area by "
        f"{changes[0]:+.1%} and the volume by {changes[1]:+.1%}: the mesh is coarse, or has edges "
        "and steps that are no smooth surface.",
        f"{_SMOOTH}, take degree 1, or bring a finer mesh.",
    )
    return new, new_x, report._replace(findings=(*report.findings, finding))


def _with_creases(mesh, x, degree: int, report: SurfaceReport) -> SurfaceReport:
    edges = creases(np.asarray(mesh.triangles), np.asarray(x))
    if not len(edges):
        return report
    finding = Finding(
        "creases",
        "warning",
        len(edges),
        tuple(tuple(map(int, edge)) for edge in edges[:10]),
        f"These edges are bent by more than 60° and stay sharp at degree {degree}: there the "
        "bending energy has no limit as the mesh is refined.",
        f"{_SMOOTH}, or bring a finer mesh.",
    )
    return report._replace(findings=(*report.findings, finding))


@eqx.filter_jit
def _measures(mesh, x):
    return area(mesh, x), volume(mesh, x)

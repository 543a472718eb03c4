"""Force balance as a case asks for it."""

from typing import Any

from .. import fit as fits
from ..cases import CaseError, FitTask
from ..equilibria import without_facets
from ..io import RunFolder, write_npz
from ..mesh import raise_degree
from ..plot import surface_picture
from ._fit_pictures import warned_only
from ._fit_summary import ending, identification, verdict_of

BIASED = (
    "forces of a surface that was smoothed are too weak, and no interval knows it: H0 R0 of "
    "a known vesicle in voxels of 1/20 of its radius comes out 0.3 to 0.5 too near zero. Fit the "
    'shape (method = "match") before you believe them.'
)


def balance(task: FitTask, targets, folder: RunFolder, resume: bool, progress) -> dict[str, Any]:
    """Find parameters by forces alone; the summary."""
    del progress  # one linear solve
    if resume:
        raise CaseError('a fit by "force-balance" has no steps to resume.', section="fit")
    surfaces = [(m, x) if m.degree > 1 else _lifted(m, x) for m, x in targets]
    known = {name: 0.0 for name in fits.FORCE_PARAMETERS if name not in task.fit.free}
    found = fits.force_balance(surfaces, known=known, shared=task.fit.shared, noise=task.fit.noise)
    for k, ((mesh, x), field) in enumerate(zip(surfaces, found.residuals, strict=True)):
        write_npz(folder.file(f"final_{k}.npz"), mesh, x, {"residual": field})
        if task.fit.picture:
            _draw(folder, k, mesh, x, field, found.unexplained)
    told = found.identification.identifiable
    return {
        **ending(fits.RESULTS.converged if all(told.values()) else fits.RESULTS.not_identifiable),
        **verdict_of(found.verdict, () if task.target.smooth is None else (BIASED,)),
        "parameters": list(found.parameters),
        "unexplained": found.unexplained,
        **identification(found.identification),
        "in_words": list(found.in_words()),
    }


def _lifted(mesh, x):
    """Triangles raised to degree 2, without their facets."""
    mesh, x = raise_degree(mesh, x, 2)
    return mesh, without_facets(mesh, x)


def _draw(folder: RunFolder, k: int, mesh, x, field, unexplained: float) -> None:
    with warned_only():
        surface_picture(
            folder.file(f"residual_{k}.png"),
            mesh,
            x,
            field,
            field_name="displacement",
            caption=f"force that no parameters explain: {100 * unexplained:.3g} %",
            edges=False,
        )

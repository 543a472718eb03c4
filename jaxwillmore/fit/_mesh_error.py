"""What the mesh of the model does to the parameters of a fit, judged by a coarser one."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from ..equilibria import Equilibrium, equilibrium
from ..mesh import icosphere
from ._descend import evaluate
from ._shape_fit import ShapeFit
from ._unknowns import of_unit_size

# Equilibria of degree 2 on half the mesh size are 2^4 times nearer to the limit.
ORDER = 4


def mesh_errors(fit: ShapeFit) -> dict[str, float]:
    r"""How far the mesh of the model may have moved every free parameter.

    The equilibria of the solution are found once more on meshes of twice the size. With the rows
    $r_c$ for these in place of r, the fit would move by $-J^+(r_c - r)$; for a model of order four
    a fifteenth of that is its own error. Infinite where the coarser mesh has no equilibrium; an
    order of magnitude where it is too coarse for the shape.

    Neither residuals nor intervals tell this error: to a fit it looks like a shape.

    **Raises:** `ValueError` for a fit without shapes.
    """
    if not fit.shapes:
        raise ValueError("The fit has no shapes: it had no solution.")
    residuals, u = fit.residuals, fit.u
    fine = evaluate(residuals, u).residuals
    changes, rows, used = [], [], 0
    for k, (model, seen) in enumerate(zip(residuals.models, residuals.observed, strict=True)):
        motion = residuals.unknowns.motion(u, k)
        coarse = _coarser(fit, k, model.pose.back(fit.shapes[k].x, motion))
        if not coarse.succeeded:
            return dict.fromkeys(residuals.labels, float("inf"))
        x = model.pose.place(coarse.x, motion)
        other = np.asarray(_rows(residuals.misfit, seen, coarse.mesh, coarse.x, x))
        shared = residuals.misfit.shared(seen)
        own = used + np.arange(shared)
        changes.append(other[:shared] / float(residuals.unit) - fine[own])
        rows.append(own)
        used += shared + residuals.misfit.of_model(model.equilibrium.mesh)
    J = fit.jacobian[np.concatenate(rows)]
    moved = np.linalg.lstsq(J, np.concatenate(changes), rcond=1e-8)[0][: len(residuals.labels)]
    own = np.abs(moved * np.asarray(residuals.unknowns.slopes(u))) / (2**ORDER - 1)
    return dict(zip(residuals.labels, map(float, own), strict=True))


@eqx.filter_jit
def _rows(misfit, seen, mesh, reference, x):
    return misfit.rows(seen, mesh, reference, x)[0]


def _coarser(fit: ShapeFit, k: int, x: Float[Array, "nodes 3"]) -> Equilibrium:
    """The equilibrium of one target on the mesh of twice the size, begun at the shape itself."""
    residuals = fit.residuals
    p = {name: float(v) for name, v in residuals.unknowns.parameters(fit.u, k).items()}
    by_pressure = any("scaled_pressure" in label for label in residuals.labels)
    level = round(np.log(residuals.models[k].equilibrium.mesh.n_cells / 20) / np.log(4))
    mesh, nodes = icosphere(level - 1, degree=2)
    # Models are images of icospheres: their nodes include those of the coarser one.
    kept = KDTree(np.asarray(icosphere(level, degree=2)[1])).query(np.asarray(nodes))[1]
    held = of_unit_size(p, float(residuals.sizes[k]), by_pressure)
    return equilibrium(mesh, x[kept], stability=False, throw=False, **held)

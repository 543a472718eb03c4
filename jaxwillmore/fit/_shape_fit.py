"""ShapeFit: what a shape matching found, and what it cannot know."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..fem import l2_norm
from ..mesh import SurfaceMesh
from ..surface import area, closest
from ._bootstrap import block_bootstrap
from ._descend import Descent, evaluate
from ._force_balance import KAPPA_IS_INVISIBLE
from ._identify import NO_SOLUTION, Identification
from ._pose import Pose
from ._results import RESULTS
from ._shape_residuals import FOLLOWING, ShapeResiduals
from ._statistics import laplace
from ._targets import Target
from ._unknowns import SHAPE_PARAMETERS, spoken
from ._verdict import Verdict


@dataclasses.dataclass(frozen=True)
class MatchedShape:
    r"""The model of one target.

    **Attributes:**

    - `mesh`, `x`: the equilibrium in the place of the target.
    - `parameters`: `reduced_volume`, `scaled_spontaneous_curvature` $H_0R_0$, `scaled_tension`
      $\sigma R_0^2/\kappa$, `scaled_pressure` $PR_0^3/\kappa$ of the model, and its `radius`
      $R_0$ in the units of the target.
    - `errors`: standard errors of the first four, by `ShapeFit.robust`; infinite where the data do
      not tell, 0 where held.
    - `distances`: `rms` and `largest` of the signed distances of the target's nodes to the model,
      and `largest_back`, that of the model's nodes to the target; in units of the target.
    - `residual`: the signed distance of every node of the target, positive outside of the model.
    """

    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]
    parameters: dict[str, float]
    errors: dict[str, float]
    distances: dict[str, float]
    residual: Float[np.ndarray, " points"]


@dataclasses.dataclass(frozen=True)
class ShapeFit:
    """The end of a shape matching.

    **Attributes:**

    - `shapes`: one for each target.
    - `identification`: of the free parameters, with motion and size fitted along; intervals if the
      model were right and residuals independent (Laplace).
    - `robust`: the same when the residuals of neighbouring points depend on each other: the
      discrepancy of a model that is not exactly right, by a bootstrap over blocks of the residual
      field (spherical harmonics of one degree on one target), without any further fit.
    - `rms`: root mean square of the distances that were fitted, over the mean area radius.
    - `history`: one row per accepted step.
    - `iterate`: where it ended, as plain numbers; `match_shapes(..., resume=iterate)` goes on.
    - `on_bound`: labels of parameters that ended on a bound.
    - `result`, `stats`: why it ended and what it cost.
    - `verdict`: whether the model explains the targets.
    - `residuals`, `u`, `jacobian`: the problem itself, its solution, and the derivative there.
    """

    shapes: tuple[MatchedShape, ...]
    identification: Identification
    robust: Identification
    rms: float
    history: tuple[dict[str, float], ...]
    iterate: "MatchIterate"
    on_bound: tuple[str, ...]
    result: RESULTS
    verdict: Verdict
    stats: dict[str, Any]
    residuals: ShapeResiduals
    u: Float[Array, " unknowns"]
    jacobian: Float[np.ndarray, "rows unknowns"]

    @property
    def succeeded(self) -> bool:
        """Whether the distance is least at parameters that the data determine."""
        return bool(self.result == RESULTS.converged)

    def misfit(self, u: Float[Array, " unknowns"]) -> tuple[float, bool]:
        """Norm of the residuals for other unknowns, and whether the models exist."""
        there = evaluate(self.residuals, u)
        return float(np.linalg.norm(there.residuals)), bool(there.aux.solved)

    def in_words(self) -> tuple[str, ...]:
        """What these shapes do not tell, one sentence each."""
        if not self.shapes:
            return (NO_SOLUTION,)
        meanings = {label: spoken(label) for label in self.identification.names}
        words = self.identification.in_words(meanings)
        return (self.verdict.sentence, KAPPA_IS_INVISIBLE, *words)


@dataclasses.dataclass(frozen=True)
class MatchIterate:
    """Parameters and places of all models, as plain numbers."""

    parameters: tuple[dict[str, float], ...]
    poses: tuple[dict[str, list], ...]

    def to_json(self) -> dict[str, Any]:
        """Tables of numbers; `from_json` reads them."""
        return {"parameters": list(self.parameters), "poses": list(self.poses)}

    @staticmethod
    def from_json(tables: Mapping[str, Any]) -> "MatchIterate":
        """The inverse of `to_json`.

        **Raises:** `ValueError` for anything that is no iterate.
        """
        try:
            parameters = tuple({k: float(v) for k, v in p.items()} for p in tables["parameters"])
            poses = tuple(
                {k: np.asarray(v, float).tolist() for k, v in p.items()} for p in tables["poses"]
            )
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"This is no iterate of a fit: {error!r}.") from error
        if len(parameters) != len(poses) or not all(
            set(p) == {"axes", "origin", "size"} for p in poses
        ):
            raise ValueError("This is no iterate of a fit: parameters and poses do not match.")
        return MatchIterate(parameters, poses)


def pose_numbers(pose: Pose) -> dict[str, list]:
    """A pose as plain numbers."""
    return {k: np.asarray(getattr(pose, k)).tolist() for k in ("axes", "origin", "size")}


def pose_of(numbers: Mapping[str, Any]) -> Pose:
    """The inverse of `pose_numbers`."""
    return Pose(*(jnp.asarray(numbers[k], float) for k in ("axes", "origin", "size")))


def matched(
    targets: tuple[Target, ...],
    residuals: ShapeResiduals,
    descent: Descent,
    noise: float | None,
    rank_tolerance: float,
    lost: bool,
) -> tuple[tuple[MatchedShape, ...], Identification, Identification]:
    """Everything that is said about a solution; no shapes if it is `lost`."""
    unknowns, u = residuals.unknowns, descent.u
    assert descent.aux is not None and descent.slopes is not None
    placed = [residuals.placed(x, u, k) for k, x in enumerate(descent.aux.model)]
    found, robust = statistics(targets, residuals, descent, placed, noise, rank_tolerance)
    shapes = []
    if lost:
        return (), found, robust
    for k, (target, x) in enumerate(zip(targets, placed, strict=True)):
        own = slice(k * len(FOLLOWING), (k + 1) * len(FOLLOWING))
        values, slopes = descent.aux.numbers[own], descent.slopes[own]
        size = float(residuals.sizes[k])
        motion = unknowns.motion(u, k)
        radius = float(residuals.models[k].pose.size * jnp.exp(motion[6]))
        H0 = size * float(unknowns.parameters(u, k)["scaled_spontaneous_curvature"])
        p = dict(zip(FOLLOWING, map(float, values), strict=True))
        p |= {"scaled_spontaneous_curvature": H0, "radius": radius}
        errors = _errors(residuals, descent, robust, k, slopes)
        mesh = residuals.models[k].equilibrium.mesh
        numbers, signed = distances(target, mesh, np.asarray(x))
        shapes.append(MatchedShape(mesh, x, p, errors, numbers, signed))
    return tuple(shapes), found, robust


def statistics(targets, residuals: ShapeResiduals, descent: Descent, placed, noise, rank_tolerance):
    """Laplace's intervals, and those that allow for residuals which depend on each other."""
    unknowns, u = residuals.unknowns, descent.u
    misfit = residuals.misfit
    variance = None if noise is None else misfit.variance(noise, targets)
    arguments = {
        "names": unknowns.labels,
        "values": np.asarray(unknowns.free(u)),
        "slopes": np.asarray(unknowns.slopes(u)),
        "count": misfit.count(targets),
        "variance": None if variance is None else variance / float(residuals.unit) ** 2,
        "rank_tolerance": rank_tolerance,
    }
    r, J = descent.residuals, descent.jacobian
    found = laplace(r, J, **arguments)
    if not np.any(r):
        return found, found
    models = [(m.equilibrium.mesh, x) for m, x in zip(residuals.models, placed, strict=True)]
    fields = misfit.fields(targets, models)
    return found, found.with_draws(block_bootstrap(r, J, found.influence, fields))


def _errors(residuals, descent, robust: Identification, k: int, slopes) -> dict[str, float]:
    """Standard errors of the numbers of one shape, which follow the free parameters."""
    unknowns = residuals.unknowns
    place, names = (
        unknowns.places[k][SHAPE_PARAMETERS.index("scaled_spontaneous_curvature")],
        robust.names,
    )
    of_H0 = 0.0 if place < 0 else robust.standard_errors[names[place]] * float(residuals.sizes[k])
    n = len(names)
    chain = slopes[:, :n] / np.asarray(unknowns.slopes(descent.u))[None]
    told = np.array([robust.identifiable[label] for label in names], bool)
    spread = np.sqrt(np.maximum(np.diag(chain @ robust.covariance @ chain.T), 0.0))
    spread = np.where(np.any(np.abs(chain[:, ~told]) > 1e-9, axis=1), np.inf, spread)
    return dict(zip(FOLLOWING, map(float, spread), strict=True)) | {
        "scaled_spontaneous_curvature": of_H0
    }


def distances(
    target: Target, mesh: SurfaceMesh, x: Float[np.ndarray, "nodes 3"]
) -> tuple[dict[str, float], Float[np.ndarray, " points"]]:
    """Numbers for the distances between a target and a model, and that of every node."""
    points, cells = np.asarray(target.x), np.asarray(mesh.cells)
    signed = _signed(cells, x, points)
    back = _signed(np.asarray(target.mesh.cells), points, x)
    field = jnp.asarray(signed)
    mean = float(l2_norm(target.mesh, target.x, field) / jnp.sqrt(area(target.mesh, target.x)))
    return {
        "rms": mean,
        "largest": float(np.max(np.abs(signed))),
        "largest_back": float(np.max(np.abs(back))),
    }, signed


def _signed(cells, nodes, points) -> np.ndarray:
    cell, basis = closest(cells, nodes, points)
    frame = np.einsum("pji,pjd->pid", basis, nodes[cells[cell]])
    normal = np.cross(frame[:, 1], frame[:, 2])
    gap = points - frame[:, 0]
    return np.copysign(np.linalg.norm(gap, axis=1), np.sum(normal * gap, axis=1))

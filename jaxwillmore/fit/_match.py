r"""Shape matching: parameters of equilibria that lie as near as possible to observed surfaces."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..equilibria import Equilibrium, equilibrium, spheroid
from ..evolve._interrupt import catch_interrupts
from ..mesh import SurfaceMesh
from ..surface import reduced_volume
from ._closest import closest
from ._descend import Descent, Iterate, descend
from ._pose import Pose, aligned
from ._results import RESULTS, message, name_of
from ._shape_fit import MatchIterate, ShapeFit, matched, pose_numbers, pose_of
from ._shape_residuals import (
    Model,
    ShapeResiduals,
    Target,
    bare,
    node_weights,
    target,
)
from ._targets import checked_surface
from ._unknowns import SHAPE_NAMES, Unknowns, unknowns

# A stage on one frozen reference ends when the model has moved this far from it, in R0; the last
# stage is repeated on a new reference unless the model moved less than the second number.
STRAIN_LIMIT, SETTLED_STRAIN = 0.08, 0.02
MAX_STAGES = 15
# Distance in R0 that counts as one. It weighs residuals against the damping of a descent, which
# starts at one and rarely falls: the first few steps are short in directions that hardly show.
COARSE, FINE = 0.03, 1e-3
COARSE_STEPS = 8
# A mean distance of this part of R0 is no fit at all.
HOPELESS = 0.4


def match_shapes(
    targets: Sequence[tuple[SurfaceMesh | np.ndarray, Float[Array | np.ndarray, "_ 3"]]],
    *,
    free: Sequence[str] = ("reduced_volume", "spontaneous_curvature"),
    shared: Sequence[str] = ("spontaneous_curvature",),
    start: Mapping[str, float] | None = None,
    kind: str = "prolate",
    bounds: Mapping[str, tuple[float, float]] | None = None,
    level: int = 2,
    both_ways: bool = False,
    new_references: bool = True,
    noise: float | None = None,
    tolerance: float = 1e-7,
    max_steps: int = 100,
    rank_tolerance: float = 1e-3,
    resume: MatchIterate | None = None,
    throw: bool = True,
    observer: Callable[[dict[str, float], MatchIterate], None] | None = None,
) -> ShapeFit:
    r"""Fit equilibria to observed surfaces, one for each, with parameters in common.

    The model is a stationary shape of $\int b_b (H - H_0)^2$ of held area, in units of its own
    $R_0$ and κ; rotation, translation and size are fitted along. The distance is that of the
    target's nodes to the model, by Levenberg–Marquardt with exact derivatives: implicit through
    the equilibrium, by the envelope theorem through the closest points. The reference surface of
    the equilibrium stays frozen within a stage and is made anew between stages.

    **Arguments:**

    - `targets`: closed surfaces of genus 0, pairs of a mesh (or triangles) and nodes.
    - `free`: parameters to be found: `"reduced_volume"`, `"spontaneous_curvature"` ($H_0R_0$) and,
      in place of the volume, `"pressure"` ($PR_0^3/\kappa$).
    - `shared`: parameters that are the same for all targets. $H_0R_0$ is in units of the mean
      $R_0$ of all targets, so that a shared one is one $H_0$.
    - `start`: values of free parameters to start from and of the others to hold. Left out: the
      reduced volume of each target, $H_0 = 0$.
    - `kind`: `"prolate"` or `"oblate"`, the family of shapes to start in.
    - `bounds`: other bounds than (0.25, 0.997) for the reduced volume and (-10, 10) for $H_0R_0$.
    - `level`: refinement of the model: 162, 642, 2,562 nodes for 1, 2, 3.
    - `both_ways`: also count the distance of the model's nodes to the target, which keeps the model
      from reaching beyond a target with gaps.
    - `new_references`: `False` keeps the first reference, for data made on that one.
    - `noise`: standard deviation of independent normal errors of the target's nodes, in its units;
      left out, it is taken from the residuals.
    - `tolerance`: of the unknowns and of the residuals.
    - `rank_tolerance`: singular values below this part of the largest one count as null.
    - `resume`: where an earlier fit ended or was interrupted.
    - `throw`: raise `RuntimeError` unless it succeeded; otherwise look at `result`.
    - `observer`: called with a row of numbers and the iterate after every accepted step.

    **Raises:** `ValueError` for targets that are open, turned inside out, of another genus, not
    finite, empty or collapsed, and for names or values that make no sense; `RuntimeError`.

    *Limits:* κ itself is not a parameter, nor can it be. Shapes in self-contact are not modelled.
    The distance to a rough target is not smooth; the fit then ends as `stalled` or with few digits.

    ```python
    fit = jw.fit.match_shapes([(mesh, x)], kind="oblate")
    fit.shapes[0].parameters, fit.robust.intervals()
    ```
    """
    began = time.perf_counter()
    seen = tuple(_checked(mesh, x) for mesh, x in targets)
    if not seen:
        raise ValueError("`targets` is empty; give at least one pair (mesh, x).")
    if tolerance <= 0 or max_steps < 1:
        raise ValueError("`tolerance` must be positive and `max_steps` at least 1.")
    values = _start_values(seen, free, {} if start is None else start, resume)
    layout = unknowns(free, shared, {} if bounds is None else bounds, values)
    u = layout.start(values)
    matcher = _Matcher(seen, layout, tolerance, max_steps, observer)
    with catch_interrupts() as interrupted:
        matcher.begin(values, kind, level, both_ways, resume)
        descent = matcher.run(u, new_references, interrupted)
    fit = _finished(matcher, descent, noise, rank_tolerance, began)
    if throw and not fit.succeeded:
        raise RuntimeError(f"No fit ({name_of(fit.result)}): {message(fit.result)}")
    return fit


def _checked(mesh, x) -> Target:
    mesh, x = checked_surface(mesh, x)
    if mesh.genus != 0:
        raise ValueError(
            f"A target has genus {mesh.genus}; the models here are spheres by topology. "
            "`force_balance` takes any genus."
        )
    return target(mesh, x)


def _start_values(targets, free, start, resume) -> list[dict[str, float]]:
    """Parameters of every target to start from; refuses contradictions."""
    for name in start:
        if name not in SHAPE_NAMES:
            raise ValueError(f"`start` has {name!r}; there are {', '.join(SHAPE_NAMES)}.")
    if "pressure" in free and "reduced_volume" in free:
        raise ValueError("Free `reduced_volume` or `pressure`, not both: one follows the other.")
    if len(free) == 0:
        raise ValueError("`free` is empty; name at least one parameter.")
    if resume is None and ("pressure" in free) != ("pressure" in start):
        raise ValueError("`pressure` is either free and has a value in `start`, or neither.")
    if resume is not None:
        if len(resume.parameters) != len(targets):
            raise ValueError(
                f"`resume` has {len(resume.parameters)} shapes for {len(targets)} targets."
            )
        return [dict(p) for p in resume.parameters]
    return [
        {
            "reduced_volume": float(reduced_volume(t.mesh, t.x)),
            "spontaneous_curvature": 0.0,
            "pressure": 0.0,
        }
        | {name: float(value) for name, value in start.items()}
        for t in targets
    ]


class _Matcher:
    """The loop over stages: models on frozen references, a descent, new references."""

    def __init__(
        self, targets: tuple[Target, ...], layout: Unknowns, tolerance, max_steps, observer
    ):
        self.targets, self.layout = targets, layout
        self.tolerance, self.max_steps, self.observer = tolerance, max_steps, observer
        self.by_pressure = any("pressure" in label for label in layout.labels)
        self.radius = float(np.mean([float(t.radius) for t in targets]))
        self.sizes = jnp.asarray([float(t.radius) / self.radius for t in targets])
        self.history: list[dict[str, float]] = []
        self.steps = self.stages = 0
        self.resolution = COARSE

    def begin(self, values, kind: str, level: int, both_ways: bool, resume) -> None:
        """Models at the start values, laid along the principal axes of their targets."""
        models = []
        for k, (t, p) in enumerate(zip(self.targets, values, strict=True)):
            mesh, x = spheroid(min(p["reduced_volume"], 0.99), kind, level)
            shape = self._equilibrium(mesh, x, p, k)
            pose = _best_pose(shape, t) if resume is None else pose_of(resume.poses[k])
            models.append(Model(bare(shape), pose))
        count = sum(t.count for t in self.targets)
        self.residuals = ShapeResiduals(
            tuple(models),
            tuple(t.observed for t in self.targets),
            self.layout,
            self.sizes,
            jnp.asarray(self.radius * COARSE * np.sqrt(count)),
            both_ways,
        )

    def _equilibrium(self, mesh, x, p, k: int) -> Equilibrium:
        name = "pressure" if self.by_pressure else "reduced_volume"
        held: dict[str, Any] = {"area": 4 * np.pi, name: p[name]}
        return equilibrium(
            mesh,
            x,
            spontaneous_curvature=p["spontaneous_curvature"] * float(self.sizes[k]),
            stability=False,
            throw=False,
            **held,
        )

    def run(self, u, new_references: bool, interrupted: Callable[[], bool]) -> Descent:
        """Descend, stage by stage, until one ends near its own reference."""
        self.interrupted = interrupted
        while True:
            self.stages += 1
            coarse = self.resolution == COARSE
            left = self.max_steps - self.steps
            descent = descend(
                self.residuals,
                u,
                tolerance=self.tolerance,
                max_steps=min(COARSE_STEPS, left) if coarse else left,
                strain_limit=STRAIN_LIMIT if new_references else np.inf,
                observer=self._seen,
                interrupted=interrupted,
            )
            self.steps += descent.steps
            result, u = descent.result, descent.u
            done = result is not None and bool(result == RESULTS.converged)
            if result is not None and not done and not (coarse and _may_go_on(result)):
                return descent
            if coarse and result is not None:
                self._refine()
                done = False
            if new_references and descent.strain > SETTLED_STRAIN:
                if self.stages >= MAX_STAGES or not self._new_references(u):
                    return descent._replace(result=RESULTS.stalled)
                u = self._still(u)
            elif done:
                return descent

    def _refine(self) -> None:
        factor = FINE / self.resolution
        self.resolution = FINE
        unit = self.residuals.unit * factor
        self.residuals = eqx.tree_at(lambda r: r.unit, self.residuals, unit)

    def _new_references(self, u) -> bool:
        """Models on references that belong to their shapes; whether they could be made."""
        models = []
        for k, model in enumerate(self.residuals.models):
            found, _, _ = self.residuals.shape(u, k)
            p = {name: float(v) for name, v in self.layout.parameters(u, k).items()}
            shape = self._equilibrium(model.equilibrium.mesh, found.x, p, k)
            if not shape.succeeded:
                return False
            models.append(Model(bare(shape), model.pose.moved(self.layout.motion(u, k))))
        self.residuals = eqx.tree_at(lambda r: r.models, self.residuals, tuple(models))
        return True

    def _still(self, u):
        """The same parameters without motion, which the poses have taken up."""
        n = len(self.layout.labels)
        return jnp.concatenate([u[:n], jnp.zeros(len(u) - n)])

    def _seen(self, iterate: Iterate) -> None:
        row = {
            "step": float(len(self.history)),
            "stage": float(self.stages),
            "rms": self.rms(iterate.objective),
            "strain": iterate.strain,
        }
        free = np.asarray(self.layout.free(iterate.u))
        row |= {label: float(v) for label, v in zip(self.layout.labels, free, strict=True)}
        self.history.append(row)
        if self.observer is not None:
            self.observer(row, self.iterate(iterate.u))

    def rms(self, objective: float) -> float:
        """Root mean square distance over the mean area radius, from the objective."""
        sides = 2 if self.residuals.both_ways else 1
        return float(np.sqrt(2 * objective / sides) * self.resolution)

    def iterate(self, u) -> MatchIterate:
        """Parameters and places of all models."""
        parameters, poses = [], []
        for k, model in enumerate(self.residuals.models):
            p = self.layout.parameters(u, k)
            parameters.append({name: float(value) for name, value in p.items()})
            poses.append(pose_numbers(model.pose.moved(self.layout.motion(u, k))))
        return MatchIterate(tuple(parameters), tuple(poses))


def _may_go_on(result: RESULTS) -> bool:
    """Whether an end of the first steps is no end of the fit."""
    return bool(result == RESULTS.step_limit) or bool(result == RESULTS.stalled)


def _best_pose(shape: Equilibrium, t: Target) -> Pose:
    """The nearest of the frames that lay principal axes along each other."""
    x, points = np.asarray(shape.x), np.asarray(t.x)
    weights = np.asarray(node_weights(shape.mesh, shape.x))
    own = np.asarray(node_weights(t.mesh, t.x))
    cells = np.asarray(shape.mesh.cells)

    def distance(pose: Pose) -> float:
        nodes = np.asarray(pose.place(jnp.asarray(x), jnp.zeros(7)))
        cell, basis = closest(cells, nodes, points)
        gap = points - np.einsum("pj,pjd->pd", basis[..., 0], nodes[cells[cell]])
        return float(np.sum(own[:, None] * gap**2))

    return min(aligned(x, weights, points, own, float(t.radius)), key=distance)


def _finished(matcher: _Matcher, descent: Descent, noise, rank_tolerance, began) -> ShapeFit:
    layout, u = matcher.layout, descent.u
    result = RESULTS.stalled if descent.result is None else descent.result
    lost = any(bool(result == r) for r in (RESULTS.model_failed, RESULTS.not_finite))
    if lost:
        rows = np.zeros(descent.jacobian.shape)
        descent = descent._replace(residuals=np.zeros(len(rows)), jacobian=rows)
    described = matched(matcher.targets, matcher.residuals, descent, noise, rank_tolerance, lost)
    shapes, found, robust = described
    rms = matcher.rms(descent.objective)
    bound = layout.on_bound(u)
    if bool(result == RESULTS.converged):
        if rms > HOPELESS or rms > matcher.history[0]["rms"] * (1 + 1e-3):
            result = RESULTS.diverged
        elif bound:
            result = RESULTS.on_bound
        elif not all(found.identifiable.values()):
            result = RESULTS.not_identifiable
    stats = {
        "steps": matcher.steps,
        "stages": matcher.stages,
        "seconds": time.perf_counter() - began,
        "model_nodes": matcher.residuals.models[0].equilibrium.mesh.n_nodes,
    }
    return ShapeFit(
        shapes=shapes,
        identification=found,
        robust=robust,
        rms=rms,
        history=tuple(matcher.history),
        iterate=matcher.iterate(u),
        on_bound=bound,
        result=result,
        stats=stats,
        residuals=matcher.residuals,
        u=u,
        jacobian=descent.jacobian,
    )

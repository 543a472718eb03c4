"""The loop of a shape matching: models on frozen references, a descent, new references."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._observers import asks_to_stop
from ..equilibria import Equilibrium, equilibrium
from ..surface import closest, inertia_tensor
from ._descend import Descent, Iterate, descend
from ._misfit import AbstractMisfit, node_weights
from ._pose import Pose, aligned
from ._results import RESULTS
from ._shape_fit import MatchIterate, pose_numbers, pose_of
from ._shape_residuals import Model, ShapeResiduals, bare
from ._starts import BOWL, kind_of, start_surface
from ._targets import Target
from ._unknowns import Unknowns, of_unit_size

# A stage on one frozen reference ends when the model has moved this far from it, in R0; the last
# stage is repeated on a new reference unless the model moved less than the second number.
STRAIN_LIMIT, SETTLED_STRAIN = 0.08, 0.02
MAX_STAGES = 15
# Distance in R0 that counts as one. It weighs residuals against the damping of a descent, which
# starts at one and rarely falls: the first few steps are short in directions that hardly show.
COARSE, FINE = 0.03, 1e-3
COARSE_STEPS = 8
# A new reference with moments of inertia that differ by this part belongs to another shape.
SAME_SHAPE = 0.1
# How far a start that is not of the wanted kind is taken back in reduced volume.
BACK, MOST_BACK, LEAST_VOLUME = 0.04, 5, 0.4


class Matcher:
    """The loop over stages: models on frozen references, a descent, new references."""

    def __init__(
        self,
        targets: tuple[Target, ...],
        layout: Unknowns,
        misfit: AbstractMisfit,
        tolerance,
        max_steps,
        observer,
    ):
        self.targets, self.layout, self.misfit = targets, layout, misfit
        self.observed = tuple(misfit.observe(t) for t in targets)
        self.tolerance, self.max_steps, self.observer = tolerance, max_steps, observer
        self.by_pressure = any("scaled_pressure" in label for label in layout.labels)
        self.radius = float(np.mean([float(t.radius) for t in targets]))
        self.sizes = jnp.asarray([float(t.radius) / self.radius for t in targets])
        self.history: list[dict[str, float]] = []
        self.steps = self.stages = 0
        self.resolution = COARSE

    def begin(self, values, kind: str, level: int, resume) -> None:
        """Models at the start values, laid along the principal axes of their targets."""
        models = []
        for k, (t, p) in enumerate(zip(self.targets, values, strict=True)):
            shape = self._first(kind, level, p, k)
            pose = _best_pose(shape, t) if resume is None else pose_of(resume.poses[k])
            models.append(Model(bare(shape), pose))
        self.residuals = ShapeResiduals(
            tuple(models),
            self.observed,
            self.misfit,
            self.layout,
            self.sizes,
            jnp.asarray(self.radius * COARSE * np.sqrt(self.misfit.mass(self.targets))),
        )

    def has_kind(self, kind: str) -> bool:
        """Whether the models that it began with exist and belong to a family."""
        shapes = [model.equilibrium for model in self.residuals.models]
        return all(bool(s.succeeded) and _is(s, kind) for s in shapes)

    def _equilibrium(self, mesh, x, p, k: int) -> Equilibrium:
        held = of_unit_size(p, float(self.sizes[k]), self.by_pressure)
        return equilibrium(mesh, x, stability=False, throw=False, **held)

    def _first(self, kind: str, level: int, p: dict[str, float], k: int) -> Equilibrium:
        """The shape of the wanted kind at the start values.

        Where it is unstable the way from a spheroid leads to the other kind: then it is followed
        from a smaller volume, at which it may be stable.
        """
        v = min(p["reduced_volume"], 0.99)
        shape = self._equilibrium(*start_surface(kind, v, level), p, k)
        if self.by_pressure or kind == BOWL or not shape.succeeded or _is(shape, kind):
            return shape
        for step in range(1, MOST_BACK + 1):
            volumes = v - BACK * np.arange(step, 0, -1)
            if volumes[0] < LEAST_VOLUME:
                break
            q = p | {"reduced_volume": float(volumes[0])}
            near = self._equilibrium(*start_surface(kind, volumes[0], level), q, k)
            for volume in (*volumes[1:], v):
                if not near.succeeded or not _is(near, kind):
                    break
                q = p | {"reduced_volume": float(volume)}
                near = self._moved(near, q, k)
            else:
                if near.succeeded and _is(near, kind):
                    return near
        return shape

    def _moved(self, near: Equilibrium, p: dict[str, float], k: int) -> Equilibrium:
        """The neighbour of an equilibrium at other parameters, stable or not."""
        still = Pose(jnp.eye(3), jnp.zeros(3), jnp.ones(()))
        values = {name: jnp.asarray(value) for name, value in p.items()}
        values["scaled_spontaneous_curvature"] *= self.sizes[k]
        found, _ = Model(bare(near), still).solved(values)
        return self._equilibrium(near.mesh, found.x, p, k)

    def run(self, u, new_references: bool, interrupted: Callable[[], bool]) -> Descent:
        """Descend, stage by stage, until one ends near its own reference."""
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
            finer = coarse and result is not None
            if new_references and descent.strain > SETTLED_STRAIN:
                if self.stages >= MAX_STAGES or not self._new_references(descent):
                    end = RESULTS.interrupted if interrupted() else RESULTS.stalled
                    return descent._replace(result=end)
                u = self._still(u)
            elif done and not finer:
                return descent
            if finer:
                self._refine()

    def _refine(self) -> None:
        factor = FINE / self.resolution
        self.resolution = FINE
        unit = self.residuals.unit * factor
        self.residuals = eqx.tree_at(lambda r: r.unit, self.residuals, unit)

    def _new_references(self, descent: Descent) -> bool:
        """Models on references that belong to their shapes; whether they could be made."""
        assert descent.aux is not None
        models, u = [], descent.u
        for k, (model, x) in enumerate(zip(self.residuals.models, descent.aux.model, strict=True)):
            p = {name: float(v) for name, v in self.layout.parameters(u, k).items()}
            shape = self._equilibrium(model.equilibrium.mesh, x, p, k)
            # An unstable shape may have run away to another one, far from the target.
            if not shape.succeeded or _apart(shape.mesh, x, shape.x) > SAME_SHAPE:
                return False
            models.append(Model(bare(shape), model.pose.moved(self.layout.motion(u, k))))
        self.residuals = eqx.tree_at(lambda r: r.models, self.residuals, tuple(models))
        return True

    def _still(self, u):
        """The same parameters without motion, which the poses have taken up."""
        n = len(self.layout.labels)
        return jnp.concatenate([u[:n], jnp.zeros(len(u) - n)])

    def _seen(self, iterate: Iterate) -> bool:
        row = {
            "step": float(len(self.history)),
            "stage": float(self.stages),
            "rms": self.rms(iterate.objective),
            "strain": iterate.strain,
        }
        free = np.asarray(self.layout.free(iterate.u))
        row |= {label: float(v) for label, v in zip(self.layout.labels, free, strict=True)}
        self.history.append(row)
        return self.observer is not None and asks_to_stop(
            self.observer(row, self.iterate(iterate.u))
        )

    def rms(self, objective: float) -> float:
        """Root mean square distance over the mean area radius, from the objective."""
        return float(np.sqrt(2 * objective) * self.resolution)

    def iterate(self, u) -> MatchIterate:
        """Parameters and places of all models."""
        parameters, poses = [], []
        for k, model in enumerate(self.residuals.models):
            p = self.layout.parameters(u, k)
            parameters.append({name: float(value) for name, value in p.items()})
            poses.append(pose_numbers(model.pose.moved(self.layout.motion(u, k))))
        return MatchIterate(tuple(parameters), tuple(poses))


def _apart(mesh, one, other) -> float:
    """Largest relative difference of the principal moments of inertia."""
    a, b = (np.linalg.eigvalsh(np.asarray(inertia_tensor(mesh, x))) for x in (one, other))
    return float(np.max(np.abs(a / b - 1)))


def _is(shape: Equilibrium, kind: str) -> bool:
    return kind_of(shape.mesh, shape.x) == kind


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
        nodes = np.asarray(pose.origin) + float(pose.size) * x @ np.asarray(pose.axes).T
        cell, basis = closest(cells, nodes, points)
        gap = points - np.einsum("pj,pjd->pd", basis[..., 0], nodes[cells[cell]])
        return float(np.sum(own[:, None] * gap**2))

    return min(aligned(x, weights, points, own, float(t.radius)), key=distance)

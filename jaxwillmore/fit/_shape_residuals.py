"""Distances between equilibria and observed surfaces, as residuals of a least-squares problem."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..equilibria import Equilibrium, Parameters, Resolved, resolve
from ..fem import gather, load, rule_for
from ..mesh import SurfaceMesh
from ..surface import area_radius, centroid
from ._descend import Aux
from ._distance import Surface, signed_distance
from ._parameters import AbstractRange
from ._pose import Pose
from ._unknowns import Unknowns

# Where the model has no solution: far above any distance, so that the step is rejected.
NOWHERE = 1e3
# Arrays are padded to multiples of this, so that targets of similar size share compiled functions.
PADDING = 512
# Degree of exactness of the points on curved triangles: six of them.
SAMPLING = 4


class Target(eqx.Module):
    r"""An observed surface.

    **Attributes:**

    - `mesh`, `x`: the surface.
    - `padded`: the same with repeated cells and nodes.
    - `points`, `weights`: where its distance to a model is taken, padded with weight zero. The
      nodes of a triangulation, with weight one: each is an observation. Of curved triangles, points
      inside of them with their part of the area, of mean one.
    - `radius`: $R_0 = \sqrt{|\Gamma|/4\pi}$.
    - `centre`: its centre of area.
    """

    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]
    padded: Surface
    points: Float[Array, "points 3"]
    weights: Float[Array, " points"]
    radius: Float[Array, ""]
    centre: Float[Array, "3"]

    @property
    def count(self) -> int:
        """Number of points that are no padding."""
        return int(np.count_nonzero(np.asarray(self.weights)))

    @property
    def observed(self) -> "Observed":
        """What residuals need of it."""
        return Observed(self.padded, self.points, self.weights)


class Observed(eqx.Module):
    """Arrays of a target, without its mesh: shapes of similar targets agree."""

    surface: Surface
    points: Float[Array, "points 3"]
    weights: Float[Array, " points"]


def target(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Target:
    """Prepare a checked surface."""
    points, weights = (x, jnp.ones(len(x))) if mesh.degree == 1 else _samples(mesh, x)
    padded = _padded(np.asarray(points))
    weights = np.concatenate([np.asarray(weights), np.zeros(len(padded) - len(points))])
    surface = Surface(
        jnp.asarray(_padded(np.asarray(mesh.cells))), jnp.asarray(_padded(np.asarray(x)))
    )
    return Target(
        mesh,
        x,
        surface,
        jnp.asarray(padded),
        jnp.asarray(weights),
        area_radius(mesh, x),
        centroid(mesh, x),
    )


def _samples(mesh: SurfaceMesh, x):
    """Quadrature points of curved triangles, and the area that belongs to each, of mean one.

    Nodes of one surface tend to sit near nodes of another, where elements have kinks and a distance
    has no derivative.
    """
    rule = rule_for(mesh, SAMPLING)
    J = jnp.einsum("qji,tjd->tqid", rule.phi, gather(mesh, x))
    weights = rule.weights[None] * jnp.linalg.norm(jnp.cross(J[:, :, 1], J[:, :, 2]), axis=-1)
    return J[:, :, 0].reshape(-1, 3), (weights / jnp.mean(weights)).reshape(-1)


def _padded(array: np.ndarray) -> np.ndarray:
    missing = -len(array) % PADDING
    return np.concatenate([array, np.repeat(array[-1:], missing, axis=0)])


class Model(eqx.Module):
    """An equilibrium of unit area radius on a frozen reference, and where it stands."""

    equilibrium: Equilibrium
    pose: Pose

    def solved(self, parameters: dict[str, Array]) -> tuple[Resolved, Bool[Array, ""]]:
        """The equilibrium for other parameters, in units of its size and κ, and whether it exists.

        Where it does not, the one of the reference stands in for it.
        """
        one = jnp.ones(())
        p = Parameters(
            0.5 * one,
            parameters["spontaneous_curvature"] * one,
            4 * jnp.pi * one,
            parameters["reduced_volume"] * 4 * jnp.pi / 3,
            jnp.zeros(()),
            parameters["pressure"] * one,
        )
        # The implicit function theorem has nothing to say where Newton's method went astray: find
        # that out first, without derivatives.
        exists = resolve(self.equilibrium, jax.lax.stop_gradient(p)).converged
        own = self.equilibrium.parameters
        p = jax.tree.map(lambda there, here: jnp.where(exists, there, here), p, own)
        return resolve(self.equilibrium, p), exists


def bare(equilibrium: Equilibrium) -> Equilibrium:
    """An equilibrium without its numbers for people, which would compile everything anew."""
    return eqx.tree_at(
        lambda e: (e.residual, e.negative_directions, e.eigenvalues, e.stats),
        equilibrium,
        (0.0, None, (), {}),
        is_leaf=lambda leaf: leaf is None,
    )


class ShapeResiduals(eqx.Module):
    r"""Residuals $d/(R\,\delta\,\sqrt N)$ of all distances d, with one N and R for all targets.

    **Attributes:**

    - `models`, `observed`: one of each for every target.
    - `unknowns`: what is free.
    - `sizes`: area radius of every target over the mean R of all: a shared spontaneous curvature
      is one of 1/length.
    - `unit`: $R\,\delta\,\sqrt N$.
    - `both_ways`: also from the nodes of the model to the target, and not only from the points of
      the target to the model.
    """

    models: tuple[Model, ...]
    observed: tuple[Observed, ...]
    unknowns: Unknowns
    sizes: Float[Array, " targets"]
    unit: Float[Array, ""]
    both_ways: bool = eqx.field(static=True)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the free parameters, which are the first of the unknowns."""
        return self.unknowns.labels

    @property
    def ranges(self) -> tuple[AbstractRange, ...]:
        """One for each label."""
        return self.unknowns.ranges

    def shape(self, u: Float[Array, " unknowns"], k: int):
        """The equilibrium of one target, whether it exists, and its nodes in their place."""
        p = dict(self.unknowns.parameters(u, k))
        p["spontaneous_curvature"] = p["spontaneous_curvature"] * self.sizes[k]
        found, exists = self.models[k].solved(p)
        return found, exists, self.models[k].pose.place(found.x, self.unknowns.motion(u, k))

    def __call__(self, u: Float[Array, " unknowns"]) -> tuple[Float[Array, " rows"], Aux]:
        rows, solved, strains = [], [], []
        for k, (model, seen) in enumerate(zip(self.models, self.observed, strict=True)):
            found, exists, x = self.shape(u, k)
            r = model.equilibrium.reference
            own = [jnp.sqrt(seen.weights) * signed_distance(Surface(r.mesh.cells, x), seen.points)]
            if self.both_ways:
                # The part of the area of each node; both ways count the same.
                weights = node_weights(r.mesh, r.X) * jnp.sum(seen.weights)
                own.append(-jnp.sqrt(weights) * signed_distance(seen.surface, x))
            own = jnp.concatenate(own) / self.unit
            rows.append(jnp.where(exists, own, NOWHERE))
            solved.append(exists)
            away = found.x - model.equilibrium.units.outward(r.X)
            strains.append(jnp.max(jnp.linalg.norm(away, axis=1)))
        aux = Aux(jnp.all(jnp.stack(solved)), jnp.max(jnp.stack(strains)))
        return jnp.concatenate(rows), aux


def node_weights(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, " nodes"]:
    """Part of the area that belongs to each node, positive and of sum one."""
    weights = load(mesh, x, lambda _, __, phi, ___: phi**2)
    return weights / jnp.sum(weights)

r"""What counts as the difference of two surfaces: distances of points, or of harmonics."""

import abc
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial import KDTree

from ..fem import load, rule_for
from ..mesh import SurfaceMesh
from ..surface import body_centroid, distance_to_cells, radial_coefficients
from ._bootstrap import Field, sphere_directions, waves_at
from ._statistics import patches_of
from ._targets import Target, sides


class AbstractMisfit(eqx.Module):
    """Rows of differences between models and targets, and their statistics.

    The mean square of a distance is the sum of the squares of all rows over `mass`.
    """

    @abc.abstractmethod
    def observe(self, target: Target) -> eqx.Module:
        """What `rows` needs of a target.

        **Raises:** `ValueError` for a target that this misfit does not understand.
        """

    @abc.abstractmethod
    def rows(
        self,
        seen: Any,
        mesh: SurfaceMesh,
        reference: Float[Array, "nodes 3"],
        x: Float[Array, "nodes 3"],
    ) -> tuple[Float[Array, " rows"], Bool[Array, ""]]:
        """Differences of a model from what was observed, and whether they mean anything.

        **Arguments:**

        - `seen`: what `observe` gave.
        - `reference`: nodes that give weights to the nodes `x` of the model; held fixed.
        """

    @abc.abstractmethod
    def shared(self, seen: Any) -> int:
        """Number of leading rows that mean the same for models on all meshes."""

    @abc.abstractmethod
    def of_model(self, mesh: SurfaceMesh) -> int:
        """Number of rows after these, which belong to the mesh of the model."""

    @abc.abstractmethod
    def mass(self, targets: Sequence[Target]) -> float:
        """Sum of squares of all rows over the mean square distance."""

    @abc.abstractmethod
    def count(self, targets: Sequence[Target]) -> int:
        """Number of rows that are no padding."""

    @abc.abstractmethod
    def variance(self, noise: float, targets: Sequence[Target]) -> float:
        """Variance of a row when the nodes of the targets have independent errors `noise`."""

    @abc.abstractmethod
    def fields(
        self,
        targets: Sequence[Target],
        models: Sequence[tuple[SurfaceMesh, Float[Array, "_ 3"]]],
    ) -> list[Field]:
        """How the rows of every target lie on it; `models` are where they stand."""


class Points(AbstractMisfit):
    """Signed distances of the points of a target to the model.

    **Attributes:**

    - `both_ways`: also from the nodes of the model to the target. Both ways count half: together
      they say as much about the points as one way does, whose errors are in both.
    """

    both_ways: bool = eqx.field(static=True)

    def observe(self, target):
        return target.observed

    def rows(self, seen, mesh, reference, x):
        half = 0.5 if self.both_ways else 1.0
        own = [jnp.sqrt(half * seen.weights) * distance_to_cells(mesh.cells, x, seen.points)]
        if self.both_ways:
            # The part of the area of each node.
            weights = half * node_weights(mesh, reference) * jnp.sum(seen.weights)
            own.append(
                -jnp.sqrt(weights) * distance_to_cells(seen.surface.cells, seen.surface.nodes, x)
            )
        return jnp.concatenate(own), jnp.ones((), bool)

    def shared(self, seen):
        return len(seen.points)

    def of_model(self, mesh):
        return mesh.n_nodes if self.both_ways else 0

    def mass(self, targets):
        return float(self.count(targets))

    def count(self, targets):
        return sum(t.count for t in targets)

    def variance(self, noise, targets):
        return noise**2

    def fields(self, targets, models):
        found = []
        for target, (mesh, x) in zip(targets, models, strict=True):
            half = 0.5 if self.both_ways else 1.0
            points, sizes = np.asarray(target.points), half * np.asarray(target.weights)
            patches = patches_of(points)
            where = sphere_directions(mesh, x, points)
            if self.both_ways:
                nearest = KDTree(points).query(np.asarray(x))[1]
                patches = np.concatenate([patches, patches[nearest]])
                where = np.concatenate([where, sphere_directions(mesh, x, np.asarray(x))])
                own = np.asarray(node_weights(mesh, x)) * np.sum(sizes)
                sizes = np.concatenate([sizes, own])
            found.append(waves_at(where, np.sqrt(sizes), patches))
        return found


class ObservedRadius(eqx.Module):
    """The radius of a star-shaped target about its centre, as harmonics."""

    coefficients: Float[Array, " harmonics"]
    centre: Float[Array, "3"]


class Harmonics(AbstractMisfit):
    r"""Differences of the harmonic coefficients of the radius about the centre of the target.

    By Parseval's identity their squares sum to $\int_{S^2}(r_{model} - r_{target})^2$, but for
    what lies above `max_degree`. Smooth in everything, and of the order of the surfaces
    themselves: the error of an integral, not that of single points. Parts that are far from the
    centre, or seen at a slant, count by the angle that they fill.
    """

    max_degree: int = eqx.field(static=True)

    def observe(self, target):
        centre = body_centroid(target.mesh, target.x)
        c, star_shaped = _coefficients(target.mesh, target.x, self.max_degree, centre)
        if not bool(star_shaped):
            positions, normals = sides(target.mesh, target.x, rule_for(target.mesh, 10, fine=True))
            r = positions - np.asarray(centre)
            outward = np.sum(r * normals, axis=1) / np.linalg.norm(r, axis=1)
            worst = positions[np.argmin(outward)]
            here, there = (", ".join(f"{a:.4g}" for a in point) for point in (centre, worst))
            raise ValueError(
                f"A target is not star-shaped: from its centre ({here}) the surface is not seen "
                f"from inside near ({there}). Harmonics of a radius do not describe it; use "
                'distance="points".'
            )
        return ObservedRadius(c, centre)

    def rows(self, seen, mesh, reference, x):
        c, star_shaped = radial_coefficients(mesh, x, self.max_degree, seen.centre)
        return seen.coefficients - c, star_shaped

    def shared(self, seen):
        return len(seen.coefficients)

    def of_model(self, mesh):
        return 0

    def mass(self, targets):
        return 4 * math.pi * len(targets)

    def count(self, targets):
        return len(targets) * (self.max_degree + 1) ** 2

    def variance(self, noise, targets):
        # A coefficient sums N radii, each with the angle 4π/N, against a harmonic of norm one.
        return noise**2 * 4 * math.pi * len(targets) / sum(t.count for t in targets)

    def fields(self, targets, models):
        own = (self.max_degree + 1) ** 2
        return [Field(np.eye(own), np.zeros(own, int)) for _ in targets]


_coefficients = eqx.filter_jit(radial_coefficients)


def node_weights(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, " nodes"]:
    """Part of the area that belongs to each node, positive and of sum one."""
    weights = load(mesh, x, lambda _, __, phi, ___: phi**2)
    return weights / jnp.sum(weights)

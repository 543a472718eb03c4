"""Target surfaces: what a fit accepts as data, why it refuses the rest, and where it looks."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..fem import Rule, gather, rule_for
from ..mesh import SurfaceMesh, check_surface
from ..surface import area_radius, centroid, volume

# Arrays are padded to multiples of this, so that targets of similar size share compiled functions.
PADDING = 512
# Degree of exactness of the points on curved triangles: six of them.
SAMPLING = 4


def checked_surface(
    mesh: SurfaceMesh | np.ndarray, x, *, least_degree: int = 1
) -> tuple[SurfaceMesh, Float[Array, "nodes 3"]]:
    """A closed surface, in one piece, finite, outward, neither empty nor collapsed.

    **Arguments:**

    - `mesh`: a mesh, or the triangles of one.
    - `x`: its nodes.

    **Raises:** `ValueError` naming what is wrong and what to do.
    """
    points = np.asarray(x)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise ValueError(f"A target needs nodes of shape (nodes, 3); got {points.shape}.")
    if points.dtype.kind not in "iuf":
        raise ValueError(f"A target needs real numbers; got {points.dtype}.")
    points = points.astype(np.float64)
    wrong = np.count_nonzero(~np.all(np.isfinite(points), axis=1))
    if wrong:
        raise ValueError(f"{wrong} of {len(points)} nodes of the target are not finite.")
    extent = np.ptp(points, axis=0)
    if not np.all(extent > 1e-9 * max(float(extent.max()), float(np.abs(points).max()))):
        raise ValueError(
            f"The target is flat or a point: its extent is {extent.tolist()}. "
            "A fit needs a closed surface."
        )
    if not isinstance(mesh, SurfaceMesh):
        mesh = _closed(np.asarray(mesh), points)
    if points.shape[0] != mesh.n_nodes:
        raise ValueError(f"The target has {mesh.n_nodes} nodes but `x` has {len(points)} rows.")
    if mesh.degree < least_degree:
        raise ValueError(
            f"A target of degree {mesh.degree} has no curvature to speak of; at least "
            f"{least_degree} is needed. Use `surface.smoothed` or `surface.spherical`."
        )
    nodes = jnp.asarray(points)
    enclosed = float(volume(mesh, nodes))
    if not enclosed > 0:
        raise ValueError(
            f"The target encloses the volume {enclosed:.3g}: its triangles are turned inside out. "
            "Swap two columns of the triangles, or read it with `fix_orientation`."
        )
    return mesh, nodes


def _closed(triangles, points) -> SurfaceMesh:
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise ValueError(f"A target needs triangles of shape (cells, 3); got {triangles.shape}.")
    check_surface(points, triangles, self_intersections=False).raise_if_bad()
    return SurfaceMesh(triangles, 1, len(points))


class Surface(eqx.Module):
    """Cells and nodes without any check or claim: what a search for closest points needs."""

    cells: Int[Array, "cells local"]
    nodes: Float[Array, "nodes 3"]


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
    positions, normals = _frames(mesh, x, rule)
    weights = rule.weights[None] * jnp.linalg.norm(normals, axis=-1)
    return positions.reshape(-1, 3), (weights / jnp.mean(weights)).reshape(-1)


def _frames(mesh: SurfaceMesh, x, rule: Rule):
    """Positions and area-weighted normals at the points of all cells."""
    J = jnp.einsum("qji,tjd->tqid", rule.phi, gather(mesh, x))
    return J[:, :, 0], jnp.cross(J[:, :, 1], J[:, :, 2])


def sides(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], rule: Rule
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Points of the surface and unit normals there."""
    positions, normals = _frames(mesh, x, rule)
    normals = normals / jnp.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(positions).reshape(-1, 3), np.asarray(normals).reshape(-1, 3)


def _padded(array: np.ndarray) -> np.ndarray:
    missing = -len(array) % PADDING
    return np.concatenate([array, np.repeat(array[-1:], missing, axis=0)])

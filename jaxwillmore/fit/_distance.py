r"""Signed distances between surfaces, differentiable by the envelope theorem.

The distance of a point to a surface is stationary in the closest point. So the closest points may
be found on the host and taken as fixed: with $q$ on the surface and the unit vector $e$ from $q$ to
$p$, $d = e\cdot(p - q)$ and $\delta d = e\cdot(\delta p - \delta q)$ at a fixed place of the cell.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._closest import closest

# Gaps below this part of a cell have no direction.
NO_GAP = 1e-6


class Surface(eqx.Module):
    """Cells and nodes without any check or claim: what a closest-point search needs."""

    cells: Int[Array, "cells local"]
    nodes: Float[Array, "nodes 3"]


def signed_distance(surface: Surface, points: Float[Array, "points 3"]) -> Float[Array, " points"]:
    r"""Distance of points to a surface, positive outside; NaN for a surface that is not finite.

    First derivatives by the points and by the nodes of the surface are exact, forward and reverse.

    *Limits:* second derivatives lack the motion of the closest points. At a distance beyond the
    radius of curvature the closest point jumps, and the distance has a kink there.
    """
    cells = surface.cells
    cell, basis = jax.pure_callback(
        _search,
        (
            jax.ShapeDtypeStruct(points.shape[:1], np.int32),
            jax.ShapeDtypeStruct((points.shape[0], cells.shape[1], 3), np.float64),
        ),
        cells,
        jax.lax.stop_gradient(surface.nodes),
        jax.lax.stop_gradient(points),
        vmap_method="sequential",
    )
    frame = jnp.einsum("pji,pjd->pid", basis, surface.nodes[cells[cell]])
    gap = points - frame[:, 0]
    return jnp.sum(jax.lax.stop_gradient(_outward(frame, gap)) * gap, axis=1)


def _outward(frame, gap) -> Float[Array, "points 3"]:
    """Unit vectors along the gaps to the outside; the normals of the cells where there is no gap.

    The two differ where the closest point sits in a kink between two cells.
    """
    normal = jnp.cross(frame[:, 1], frame[:, 2])
    normal = normal / jnp.linalg.norm(normal, axis=1, keepdims=True)
    length = jnp.linalg.norm(gap, axis=1, keepdims=True)
    size = jnp.max(jnp.linalg.norm(frame[:, 1:], axis=2))
    apart = length > NO_GAP * size
    along = gap / jnp.where(apart, length, 1.0)
    side = jnp.sign(jnp.sum(normal * gap, axis=1, keepdims=True))
    return jnp.where(apart, side * along, normal)


def _search(cells, nodes, points):
    return closest(np.asarray(cells), np.asarray(nodes), np.asarray(points))

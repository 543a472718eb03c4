"""The line between two phases."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import gather
from ..mesh import SurfaceMesh
from ..reference import lagrange_basis
from ._lattice import lattice


def interface_length(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    c: Float[Array, " nodes"],
    level: float | Float[Array, ""] = 0.5,
) -> Float[Array, ""]:
    r"""Length of the line on which c = `level`, by marching through small flat triangles.

    Every cell is cut into $(2k)^2$ of them, k its degree (into one for k = 1), on which c is taken
    as linear. Of second order in h. Differentiable in `x`, `c` and `level` while the line passes no
    corner of a small triangle, and under `jit`.
    """
    p, q = jnp.moveaxis(level_segments(mesh, x, c, jnp.asarray(level, float)), 1, 0)
    square = jnp.sum((p - q) ** 2, axis=1)
    crossed = square > 0
    return jnp.sum(jnp.where(crossed, jnp.sqrt(jnp.where(crossed, square, 1.0)), 0.0))


@eqx.filter_jit
def level_segments(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    c: Float[Array, " nodes"],
    level: Float[Array, ""],
) -> Float[Array, "small 2 3"]:
    """Both ends of the piece of the line in every small triangle; one point where there is none."""
    xi, small = lattice(1 if mesh.degree == 1 else 2 * mesh.degree)
    phi = jnp.asarray(lagrange_basis(mesh.degree, xi))
    points = jnp.einsum("pj,tjd->tpd", phi, gather(mesh, x))[:, small]
    above = jnp.einsum("pj,tj->tp", phi, gather(mesh, c))[:, small] - level
    return jax.vmap(_segment)(points.reshape(-1, 3, 3), above.reshape(-1, 3))


def _segment(corners: Float[Array, "3 3"], u: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Where a linear function with the values `u` at the corners vanishes on two of the edges."""
    count = jnp.sum(u > 0)
    crossed = (count == 1) | (count == 2)
    # The corner that is alone on its side of the line: both edges from it are crossed.
    alone = jnp.argmax((u > 0) == (count == 1))
    order = (alone + jnp.arange(3)) % 3
    corners, u = corners[order], u[order]
    share = u[0] / jnp.where(crossed, u[0] - u[1:], 1.0)
    share = jnp.where(crossed, share, 0.0)
    return corners[:1] + share[:, None] * (corners[1:] - corners[:1])

"""Signed distance of given points from the curved discrete surface."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..mesh import SurfaceMesh, feet
from ._cells import cell_point, solve2


def signed_distance(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], points: Float[Array, "points 3"]
) -> Float[Array, " points"]:
    r"""Distance of each point from the surface, negative inside, length.

    The closest cells are found by a k-d tree outside of the derivative, the closest point on each
    curved cell by Newton's method. Differentiable in `x` and `points`, to second order, forward
    and reverse; by the envelope theorem $\mathrm{d}\,\mathrm{dist} = -n\cdot\phi$ when the nodes
    move with $\phi$, n the direction from the closest point to the given one.

    *Limits:* no derivative at points with several closest ones; where the closest point crosses
    an edge of the mesh, the derivative jumps at the order of the mesh. The sign is that of the
    closest cell, right unless the surface has an edge sharper than a right angle there.

    ```python
    misfit = jnp.mean(jw.surface.signed_distance(mesh, x, data) ** 2)
    ```
    """
    return distance_to_cells(mesh.cells, x, points)


def distance_to_cells(
    cells: Int[Array, "cells local"],
    x: Float[Array, "nodes 3"],
    points: Float[Array, "points 3"],
) -> Float[Array, " points"]:
    """The same for cells that need not make up a mesh; NaN where they are not finite."""
    return jax.vmap(_distance)(*_found(cells, x, points)[1:])


def distance_and_value(
    cells: Int[Array, "cells local"],
    x: Float[Array, "nodes 3"],
    field: Float[Array, " nodes"],
    points: Float[Array, "points 3"],
) -> tuple[Float[Array, " points"], Float[Array, " points"]]:
    """Signed distances, and a nodal field at the closest points; differentiable likewise."""
    cell, *near = _found(cells, x, points)

    def at(f_T, x_T, p, foot, freedom):
        return _distance(x_T, p, foot, freedom), cell_point(f_T, _moved(x_T, p, foot, freedom))

    return jax.vmap(at)(field[cells[cell]], *near)


def _found(cells, x, points):
    """The closest cell of every point, its nodes, the point, its foot and how that may move."""
    n = points.shape[0]
    cell, xi, freedom = jax.pure_callback(
        _search,
        (
            jax.ShapeDtypeStruct((n,), np.int32),
            jax.ShapeDtypeStruct((n, 2), np.float64),
            jax.ShapeDtypeStruct((n, 2, 2), np.float64),
        ),
        cells,
        *jax.lax.stop_gradient((x, points)),
        vmap_method="sequential",
    )
    return cell, x[cells[cell]], points, xi, freedom


def _search(cells, nodes, points):
    return tuple(feet(np.asarray(cells), np.asarray(nodes), np.asarray(points)))


def _slopes(x_T, p, xi):
    """Gradient of half the squared distance by `xi`, and its Hessian."""

    def half_square(xi):
        d = cell_point(x_T, xi) - p
        return 0.5 * jnp.sum(d * d)

    return jax.grad(half_square)(xi), jax.hessian(half_square)(xi)


def _moved(x_T, p, foot, freedom):
    """The foot, with its dependence on `x_T` and `p` in the open.

    One Newton step from the converged foot changes nothing but the derivatives: it lets the foot
    move as far as it is free to.
    """
    g, D = _slopes(x_T, p, foot)
    P = freedom
    return foot - P @ solve2(P @ D @ P + jnp.eye(2) - P, P @ g)


def _distance(x_T, p, foot, freedom):
    """The distance with everything that depends on `x_T` and `p` in the open."""
    P, xi = freedom, _moved(x_T, p, foot, freedom)
    T = jax.jacfwd(cell_point, 1)(x_T, xi)
    cross = jnp.cross(T[:, 0], T[:, 1])
    arm = p - cell_point(x_T, xi)
    height = jnp.dot(arm, cross) / jnp.sqrt(jnp.dot(cross, cross))
    # At an edge or a corner the arm need not be normal; its length has no derivative at zero.
    square = jnp.sum(arm * arm)
    apart = (jnp.trace(P) < 1.5) & (square > 1e-28 * jnp.sum(T * T))
    length = jnp.sqrt(jnp.where(apart, square, 1.0)) * jnp.sign(height)
    return jnp.where(apart, length, height)

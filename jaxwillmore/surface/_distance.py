"""Signed distance of given points from the curved discrete surface."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ._cells import cell_point, nearest_cells, solve2, violation

_NEWTON_STEPS = 12
_LARGEST_STEP = 0.5
# Reference coordinates; rounding at the edges of the triangle.
_INSIDE = 1e-10
_CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))


class _Foot(eqx.Module):
    """A closest point in one cell: its place, and the directions in which it is free to move."""

    xi: Float[Array, "2"]
    freedom: Float[Array, "2 2"]
    square: Float[Array, ""]


def signed_distance(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], points: Float[Array, "points 3"]
) -> Float[Array, " points"]:
    r"""Distance of each point from the surface, negative inside, length.

    The closest cells are found by a k-d tree outside of the derivative, the closest point on each
    curved cell by Newton's method. Differentiable in `x` and `points`, to second order, forward
    and reverse; by the envelope theorem $\mathrm{d}\,\mathrm{dist} = -n\cdot\phi$ when the nodes
    move with $\phi$, n the direction from the closest point to the given one.

    *Limits:* no derivative at points with several closest ones; where the closest point crosses
    an edge of the mesh, the derivative jumps at the order of the mesh. Triangles about eight times
    longer than wide may hide the closest cell from the search. The sign is that of the closest
    cell, right unless the surface has an edge sharper than a right angle there.

    ```python
    misfit = jnp.mean(jw.surface.signed_distance(mesh, x, data) ** 2)
    ```
    """
    cells, starts = nearest_cells(mesh, x, points)
    frozen = jax.lax.stop_gradient(x)

    def one(p, cells, starts):
        still = jax.lax.stop_gradient(p)
        tried = jax.vmap(lambda c, s: _foot(frozen[mesh.cells[c]], still, s))(cells, starts)
        best = jnp.argmin(tried.square)
        foot = jax.lax.stop_gradient(jax.tree.map(lambda a: a[best], tried))
        return _distance(x[mesh.cells[cells[best]]], p, foot)

    return jax.vmap(one)(points, cells, starts)


def _slopes(x_T, p, xi):
    """Gradient of half the squared distance by `xi`, and its Hessian."""

    def half_square(xi):
        d = cell_point(x_T, xi) - p
        return 0.5 * jnp.sum(d * d)

    return jax.grad(half_square)(xi), jax.hessian(half_square)(xi)


def _distance(x_T, p, foot: _Foot):
    """The distance with everything that depends on `x_T` and `p` in the open.

    One Newton step from the converged foot changes nothing but the derivatives: it lets the foot
    move as far as it is free to.
    """
    g, D = _slopes(x_T, p, foot.xi)
    P = foot.freedom
    xi = foot.xi - P @ solve2(P @ D @ P + jnp.eye(2) - P, P @ g)
    T = jax.jacfwd(cell_point, 1)(x_T, xi)
    cross = jnp.cross(T[:, 0], T[:, 1])
    arm = p - cell_point(x_T, xi)
    height = jnp.dot(arm, cross) / jnp.sqrt(jnp.dot(cross, cross))
    # At an edge or a corner the arm need not be normal; its length has no derivative at zero.
    square = jnp.sum(arm * arm)
    apart = (jnp.trace(P) < 1.5) & (square > 1e-28 * jnp.sum(cross * cross))
    length = jnp.sqrt(jnp.where(apart, square, 1.0)) * jnp.sign(height)
    return jnp.where(apart, length, height)


def _foot(x_T, p, start) -> _Foot:
    """The closest point of one cell: in its inside, else on its edges and corners."""

    def newton(_, xi):
        g, D = _slopes(x_T, p, xi)
        J = jax.jacfwd(cell_point, 1)(x_T, xi)
        # Beyond a focal point the Hessian is indefinite; Gauss and Newton's stays positive.
        convex = (D[0, 0] * D[1, 1] > D[0, 1] * D[1, 0]) & (jnp.trace(D) > 0)
        step = solve2(jnp.where(convex, D, J.T @ J), g)
        return xi - step * jnp.minimum(1.0, _LARGEST_STEP / (jnp.max(jnp.abs(step)) + 1e-300))

    xi = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, start)
    inside = violation(xi) <= _INSIDE
    far = jnp.where(inside, 0.0, jnp.inf)
    feet = [_Foot(xi, jnp.eye(2), _square(x_T, p, xi) + far)]
    for k in range(3):
        a, b = jnp.array(_CORNERS[k]), jnp.array(_CORNERS[(k + 1) % 3])
        feet.append(_foot_on_edge(x_T, p, start, a, b - a))
    stacked = jax.tree.map(lambda *parts: jnp.stack(parts), *feet)
    best = jnp.argmin(stacked.square)
    return jax.tree.map(lambda a: a[best], stacked)


def _foot_on_edge(x_T, p, start, a, e) -> _Foot:
    def newton(_, t):
        g, D = _slopes(x_T, p, a + t * e)
        J = jax.jacfwd(cell_point, 1)(x_T, a + t * e) @ e
        curvature = e @ D @ e
        step = jnp.dot(g, e) / jnp.where(curvature > 0, curvature, jnp.sum(J * J))
        return jnp.clip(t - jnp.clip(step, -_LARGEST_STEP, _LARGEST_STEP), 0.0, 1.0)

    t = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.dot(start - a, e) / jnp.dot(e, e))
    t = jnp.clip(t, 0.0, 1.0)
    free = jnp.where((t > 0) & (t < 1), 1.0, 0.0)
    xi = a + t * e
    return _Foot(xi, free * jnp.outer(e, e) / jnp.dot(e, e), _square(x_T, p, xi))


def _square(x_T, p, xi):
    d = cell_point(x_T, xi) - p
    return jnp.sum(d * d)

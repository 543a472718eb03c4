"""Cross-section profiles: how far the surface is along rays from its inside."""

import functools as ft

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ..reference import lagrange_basis
from ._cells import cell_point, nearest_cells, solve3, sub_triangles, violation
from ._moments import body_centroid

Direction = Float[Array, "3"] | tuple[float, ...]

_NEWTON_STEPS = 10
# Two steps in the open carry derivatives up to the third order.
_OPEN_STEPS = 2
_RAYS_AT_ONCE = 64


def ray_lengths(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    origins: Float[Array, "rays 3"],
    directions: Float[Array, "rays 3"],
) -> Float[Array, " rays"]:
    r"""How far rays run until they first meet the curved surface, length.

    The cell is found on a refined facet surface outside of the derivative, the point on the curved
    cell by Newton's method for $x(\xi) = o + \ell d$. Differentiable in `x`, `origins` and
    `directions`, forward and reverse: $\mathrm{d}\ell = n\cdot\phi/(n\cdot d)$.

    **Arguments:**

    - `directions`: of any length; they are normalised.

    **Raises:** a runtime error if a ray does not meet the surface.

    *Limits:* no derivative where a ray only touches the surface; where it meets an edge of the
    mesh, the derivative is that of one of the two cells, which differ at the order of the mesh.
    """
    lengths = jnp.sqrt(jnp.sum(directions**2, axis=1, keepdims=True))
    directions = directions / lengths
    still = jax.lax.stop_gradient((x, origins, directions))
    reach = jax.pure_callback(
        ft.partial(_first_hits, mesh.degree),
        jax.ShapeDtypeStruct((origins.shape[0],), jnp.float64),
        still[0],
        mesh.cells,
        *still[1:],
        vmap_method="sequential",
    )
    reach = eqx.error_if(
        reach,
        ~jnp.isfinite(reach),
        "A ray does not meet the surface. Start rays inside of it.",
    )
    cells, starts = nearest_cells(mesh, x, still[1] + reach[:, None] * still[2])

    def one(o, d, cells, starts, reach):
        frozen, o_still, d_still = jax.lax.stop_gradient((x, o, d))

        def attempt(cell, start):
            def newton(_, z):
                return _newton(frozen[mesh.cells[cell]], o_still, d_still, z)

            return jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.append(start, reach))

        tried = jax.vmap(attempt)(cells, starts)
        outside = jnp.maximum(jax.vmap(violation)(tried[:, :2]), 1e-10)
        best = jnp.argmin(jnp.where(jnp.isfinite(outside), outside, jnp.inf))
        z = jax.lax.stop_gradient(tried[best])
        x_T = x[mesh.cells[cells[best]]]
        for _ in range(_OPEN_STEPS):
            z = _newton(x_T, o, d, z)
        return z[2]

    return jax.vmap(one)(origins, directions, cells, starts, reach)


def _newton(x_T, o, d, z):
    def gap(z):
        return cell_point(x_T, z[:2]) - o - z[2] * d

    return z - solve3(jax.jacfwd(gap)(z), gap(z))


def _first_hits(degree: int, x, cells, origins, directions) -> np.ndarray:
    """Lengths of rays to the facets of the sub-triangles, inf where they miss; NumPy only."""
    x, cells = np.asarray(x), np.asarray(cells)
    origins, directions = np.asarray(origins), np.asarray(directions)
    corners = np.einsum("skl,cld->cskd", lagrange_basis(degree, sub_triangles()), x[cells])
    corners = corners.reshape(-1, 3, 3)
    a, e, f = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    out = np.full(len(origins), np.inf)
    for first in range(0, len(origins), _RAYS_AT_ONCE):
        o, d = (v[first : first + _RAYS_AT_ONCE, None] for v in (origins, directions))
        # Möller and Trumbore's solution of a + u e + v f = o + l d.
        q = np.cross(d, f[None])
        det = np.einsum("rti,ti->rt", q, e)
        with np.errstate(divide="ignore", invalid="ignore"):
            arm = o - a[None]
            u = np.einsum("rti,rti->rt", q, arm) / det
            s = np.cross(arm, e[None])
            v = np.einsum("rti,rti->rt", s, np.broadcast_to(d, s.shape)) / det
            length = np.einsum("rti,ti->rt", s, f) / det
            hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (length > 0)
        out[first : first + _RAYS_AT_ONCE] = np.where(hit, length, np.inf).min(axis=1)
    return out


def _frame(axis, towards) -> tuple[Float[Array, "3"], Float[Array, "3"], Float[Array, "3"]]:
    """The axis and two directions across it, the first one nearest to `towards`."""
    e3 = axis / jnp.linalg.norm(axis)
    across = towards - jnp.dot(towards, e3) * e3
    e1 = across / jnp.linalg.norm(across)
    return e1, jnp.cross(e3, e1), e3


def height_profile(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    heights: Float[Array, " heights"],
    *,
    axis: Direction = (0.0, 0.0, 1.0),
    towards: Direction = (1.0, 0.0, 0.0),
    n_rays: int = 8,
    centre: Float[Array, "3"] | None = None,
) -> Float[Array, " heights"]:
    r"""Mean radius around an axis at each height above the centre, length.

    **Arguments:**

    - `heights`: along `axis`, from `centre`; the axis must be inside the surface there.
    - `towards`: the first of `n_rays` evenly spaced rays; it matters only off bodies of revolution.
    - `centre`: the centre of the enclosed volume if left out.

    **Raises:** as `ray_lengths`; `ValueError` if `n_rays` is below 1.
    """
    if n_rays < 1:
        raise ValueError(f"`n_rays` must be at least 1; got {n_rays}.")
    centre = body_centroid(mesh, x) if centre is None else centre
    e1, e2, e3 = _frame(jnp.asarray(axis, float), jnp.asarray(towards, float))
    angles = 2 * np.pi * np.arange(n_rays) / n_rays
    fan = (
        jnp.asarray(np.cos(angles))[:, None] * e1[None]
        + jnp.asarray(np.sin(angles))[:, None] * e2[None]
    )
    origins = centre[None] + heights[:, None] * e3[None]
    n = heights.shape[0]
    lengths = ray_lengths(mesh, x, jnp.repeat(origins, n_rays, axis=0), jnp.tile(fan, (n, 1)))
    return jnp.mean(lengths.reshape(n, n_rays), axis=1)


def angle_profile(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    angles: Float[Array, " angles"],
    *,
    axis: Direction = (0.0, 0.0, 1.0),
    towards: Direction = (1.0, 0.0, 0.0),
    centre: Float[Array, "3"] | None = None,
) -> Float[Array, " angles"]:
    r"""Distance of the surface from its centre in a plane, as a function of the angle, length.

    Rays run along $\cos\alpha\,e_1 + \sin\alpha\,e_2$ in the plane across `axis`, $e_1$ being the
    part of `towards` in it.

    **Raises:** as `ray_lengths`.
    """
    centre = body_centroid(mesh, x) if centre is None else centre
    e1, e2, _ = _frame(jnp.asarray(axis, float), jnp.asarray(towards, float))
    directions = jnp.cos(angles)[:, None] * e1[None] + jnp.sin(angles)[:, None] * e2[None]
    return ray_lengths(mesh, x, jnp.broadcast_to(centre, directions.shape), directions)

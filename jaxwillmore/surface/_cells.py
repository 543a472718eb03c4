"""Single curved cells at any point of the reference triangle, and a search for the nearest ones."""

import functools as ft

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ..mesh import SurfaceMesh
from ..reference import lagrange_basis, lagrange_nodes

# Sub-triangles along an edge of a cell: their centres are what the search sees.
_SUBDIVISIONS = 4
# Sub-triangles tried per point; at a vertex of a regular mesh six meet.
CANDIDATES = 8


@ft.cache
def _monomial_coefficients(degree: int) -> np.ndarray:
    """Shape functions as combinations of the monomials of `_monomials`."""
    return np.linalg.inv(np.asarray(_monomials(degree, lagrange_nodes(degree))))


def _monomials(degree: int, xi):
    powers = [(i - j, j) for i in range(degree + 1) for j in range(i + 1)]
    xp = np if isinstance(xi, np.ndarray) else jnp
    return xp.stack([xi[..., 0] ** a * xi[..., 1] ** b for a, b in powers], axis=-1)


def cell_point(x_T: Float[Array, "local ..."], xi: Float[Array, "2"]) -> Float[Array, "..."]:
    """The point of a curved cell at reference coordinates; smooth in both arguments.

    With other nodal values in place of positions: their interpolation there.
    """
    degree = {3: 1, 6: 2, 10: 3, 15: 4}[x_T.shape[0]]
    basis = jnp.asarray(_monomials(degree, xi)) @ jnp.asarray(_monomial_coefficients(degree))
    return basis @ x_T


def violation(xi: Float[Array, "2"]) -> Float[Array, ""]:
    """How far reference coordinates lie outside of the triangle; not positive inside."""
    return jnp.max(jnp.stack([-xi[0], -xi[1], xi[0] + xi[1] - 1]))


def solve2(D: Float[Array, "2 2"], g: Float[Array, "2"]) -> Float[Array, "2"]:
    """Solve D u = g in closed form, which compiles to a few multiplications."""
    det = D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0]
    return jnp.stack([D[1, 1] * g[0] - D[0, 1] * g[1], D[0, 0] * g[1] - D[1, 0] * g[0]]) / det


def solve3(D: Float[Array, "3 3"], g: Float[Array, "3"]) -> Float[Array, "3"]:
    """Solve D u = g by Cramer's rule; see `solve2`."""
    a, b, c = D[:, 0], D[:, 1], D[:, 2]
    rows = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    return rows @ g / jnp.dot(a, rows[0])


@ft.cache
def sub_triangles() -> np.ndarray:
    """Reference coordinates of the corners of the sub-triangles of a cell, `(sub, 3, 2)`."""
    n = _SUBDIVISIONS
    up = [[(i, j), (i + 1, j), (i, j + 1)] for i in range(n) for j in range(n - i)]
    down = [[(i + 1, j), (i + 1, j + 1), (i, j + 1)] for i in range(n) for j in range(n - i - 1)]
    return np.array(up + down) / n


def _nearest(degree: int, x, cells, points):
    """Cells and reference coordinates of the nearest sub-triangle centres; NumPy and SciPy only."""
    x, cells, points = np.asarray(x), np.asarray(cells), np.asarray(points)
    centres = sub_triangles().mean(axis=1)
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(points))):
        shape = len(points), CANDIDATES
        return np.zeros(shape, np.int32), np.broadcast_to(centres[0], (*shape, 2)).copy()
    samples = np.einsum("sl,cld->csd", lagrange_basis(degree, centres), x[cells]).reshape(-1, 3)
    _, index = KDTree(samples).query(points, k=CANDIDATES)
    cell, sub = np.divmod(index, len(centres))
    return cell.astype(np.int32), centres[sub]


def nearest_cells(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], points: Float[Array, "points 3"]
) -> tuple[Int[Array, "points candidates"], Float[Array, "points candidates 2"]]:
    """Candidates for the cell nearest to each point, with start values; outside of derivatives."""
    n = points.shape[0]
    x, points = jax.lax.stop_gradient((x, points))
    return jax.pure_callback(
        ft.partial(_nearest, mesh.degree),
        (
            jax.ShapeDtypeStruct((n, CANDIDATES), jnp.int32),
            jax.ShapeDtypeStruct((n, CANDIDATES, 2), jnp.float64),
        ),
        x,
        mesh.cells,
        points,
        vmap_method="sequential",
    )

"""Target surfaces: what a fit accepts as data, and why it refuses the rest."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh, check_surface
from ..surface import volume


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
            f"{least_degree} is needed. Use `mesh.raise_degree` and then `equilibria.smoothed`."
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

"""More nodes on the same surface: higher degree, or four triangles in place of one."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._types import Nodes
from ..reference import lagrange_basis, lagrange_nodes
from ._adjacency import CHILD_CORNERS, lagrange_cells, scatter, split_triangles
from ._lifting import lift
from ._surface_mesh import SurfaceMesh

Projection = Callable[[Nodes], Nodes]


def raise_degree(
    mesh: SurfaceMesh | Int[Array | np.ndarray, "cells 3"],
    x: Float[Array | np.ndarray, "old_nodes 3"],
    degree: int,
    project: Projection | None = None,
) -> tuple[SurfaceMesh, Nodes]:
    """The same triangles with polynomials of a higher degree.

    Flat triangles are lifted: new nodes lie where polynomials of degree four, fitted to the
    vertices around the corners, stand over them. If the vertices lie on a smooth surface, the new
    nodes are within O(h⁵) of it, on irregular triangulations too, and not O(h²) as on the flat
    triangles. Vertices stay where they are; edges that are bent by more than 60° are creases and
    stay sharp. Triangles that are curved already keep their shape exactly.

    **Arguments:**

    - `mesh`: a mesh, or the triangles of a closed oriented surface.
    - `x`: its nodes.
    - `degree`: the new degree, not below the present one.
    - `project`: moves all nodes onto an exact surface, for example the `project` of a level set.

    **Raises:** `ValueError` if `degree` is lower than the present one, or if the triangles do not
    form a closed oriented surface.

    **Limits:** noise of the vertices is kept, and degree 4 makes twice as much bending energy of it
    as degree 2 (`scatter` estimates it). A strongly bent coarse mesh can be lifted into itself:
    look at `quality` and at the picture.

    ```python
    mesh, x = jw.mesh.raise_degree(*jw.mesh.icosphere(2, degree=1), degree=3)
    ```
    """
    mesh, points = _as_surface(mesh, x)
    if degree < mesh.degree:
        raise ValueError(f"`degree` must be at least {mesh.degree}, the present one; got {degree}.")
    cells, n_nodes = lagrange_cells(np.asarray(mesh.triangles), mesh.n_vertices, degree)
    nodes = scatter(cells, n_nodes, _evaluate(mesh, points, lagrange_nodes(degree)))
    nodes[: mesh.n_vertices] = points[: mesh.n_vertices]  # not even a rounding error
    return SurfaceMesh(cells, degree, n_nodes), _finished(nodes, project)


def refine(
    mesh: SurfaceMesh | Int[Array | np.ndarray, "cells 3"],
    x: Float[Array | np.ndarray, "old_nodes 3"],
    project: Projection | None = None,
) -> tuple[SurfaceMesh, Nodes]:
    """Every triangle cut into four of the same degree.

    Curved triangles are cut where they are, which leaves the surface unchanged; the new vertices
    of flat ones lie on the lifting that `raise_degree` uses.

    **Arguments:** as `raise_degree`.
    """
    mesh, points = _as_surface(mesh, x)
    finer = _split(mesh)
    nodes = _inherited(finer, _evaluate(mesh, points, _children(mesh.degree)))
    nodes[: mesh.n_vertices] = points[: mesh.n_vertices]
    return finer, _finished(nodes, project)


def prolongate(mesh: SurfaceMesh, u: Float[Array, "nodes ..."]) -> Float[Array, "new_nodes ..."]:
    """A finite element function on the mesh that `refine` makes of this one, unchanged.

    **Arguments:**

    - `mesh`: the mesh before it is refined.
    - `u`: nodal values on it, of any number of components.

    ```python
    finer, y = jw.mesh.refine(mesh, x)
    H = jw.mesh.prolongate(mesh, H)
    ```
    """
    values = np.asarray(u, dtype=np.float64)
    if values.shape[:1] != (mesh.n_nodes,):
        raise ValueError(f"`u` must have {mesh.n_nodes} rows; got shape {values.shape}.")
    flat = values.reshape(mesh.n_nodes, -1)
    basis = lagrange_basis(mesh.degree, _children(mesh.degree))
    inside = np.einsum("ql,tld->tqd", basis, flat[np.asarray(mesh.cells)])
    finer = _split(mesh)
    new = _inherited(finer, inside)
    return jnp.asarray(new.reshape(finer.n_nodes, *values.shape[1:]))


def _split(mesh: SurfaceMesh) -> SurfaceMesh:
    triangles, _ = split_triangles(np.asarray(mesh.triangles), mesh.n_vertices)
    n_vertices = mesh.n_vertices + mesh.n_edges
    cells, n_nodes = lagrange_cells(triangles, n_vertices, mesh.degree)
    return SurfaceMesh(cells, mesh.degree, n_nodes)


def _children(degree: int) -> Float[np.ndarray, "points 2"]:
    """Nodes of the four children as points of the reference triangle of the parent."""
    corners = lagrange_basis(1, lagrange_nodes(degree))
    return np.einsum("lc,scd->sld", corners, CHILD_CORNERS).reshape(-1, 2)


def _inherited(finer: SurfaceMesh, values) -> np.ndarray:
    """Values at the nodes of the children of every cell as one array of nodes."""
    of_child = values.reshape(finer.n_cells, -1, values.shape[-1])
    return scatter(np.asarray(finer.cells), finer.n_nodes, of_child)


def _as_surface(mesh, x) -> tuple[SurfaceMesh, np.ndarray]:
    points = np.asarray(x, dtype=np.float64)
    if not isinstance(mesh, SurfaceMesh):
        mesh = SurfaceMesh(mesh, 1, len(points))
    if points.shape != (mesh.n_nodes, 3):
        raise ValueError(f"`x` must have shape ({mesh.n_nodes}, 3); got {points.shape}.")
    return mesh, points


def _evaluate(mesh: SurfaceMesh, points, xi) -> Float[np.ndarray, "cells points 3"]:
    """Points at `xi` of every curved triangle, or of the lifting of every flat one."""
    if mesh.degree == 1:
        return lift(np.asarray(mesh.triangles), points, xi)
    return np.einsum("ql,tld->tqd", lagrange_basis(mesh.degree, xi), points[np.asarray(mesh.cells)])


def _finished(nodes, project: Projection | None) -> Nodes:
    x = jnp.asarray(nodes)
    return x if project is None else project(x)

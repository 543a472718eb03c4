"""Connectivity of a closed surface made of isoparametric Lagrange triangles."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Int

from .._types import Cells
from ..reference import n_local_nodes
from ._adjacency import edges
from ._topology import n_pieces, torn_edges


def _int32(cells) -> Cells:
    if isinstance(cells, Tracer):
        return cells
    host = np.asarray(cells)
    if not np.issubdtype(host.dtype, np.integer):
        raise ValueError(f"`cells` must hold integers; got {host.dtype}.")
    if host.size and (host.max() > np.iinfo(np.int32).max or host.min() < 0):
        raise ValueError(
            f"`cells` must hold node numbers from 0 to 2147483647; got values from "
            f"{host.min()} to {host.max()}."
        )
    return jnp.asarray(host, dtype=jnp.int32)


class SurfaceMesh(eqx.Module):
    """Connectivity of a closed oriented surface of curved triangles of degree 1, 2, 3 or 4.

    Only integers live here; the positions of the nodes travel beside the mesh as
    `x: Float[Array, "nodes 3"]`. Vertices are numbered first, then the nodes inside edges, then
    those inside triangles. The local order in a cell is that of
    `jaxwillmore.reference.lagrange_nodes`; seen from outside, vertices run counter-clockwise.

    **Arguments:**

    - `cells`: node numbers of every triangle.
    - `degree`: polynomial degree of the triangles.
    - `n_nodes`: number of nodes.

    **Raises:** `ValueError` if the numbers do not describe a closed, consistently oriented surface
    with shared nodes. `check_surface` tells where a triangulation goes wrong.

    ```python
    mesh, x = jw.mesh.icosphere(level=2, degree=2)
    assert (mesh.n_nodes, mesh.euler_characteristic) == (642, 2)
    ```
    """

    cells: Cells = eqx.field(converter=_int32)
    degree: int = eqx.field(static=True)
    n_nodes: int = eqx.field(static=True)

    def __check_init__(self):
        n_local = n_local_nodes(self.degree)
        if self.cells.ndim != 2 or self.cells.shape[1] != n_local:
            raise ValueError(
                f"`cells` needs shape (cells, {n_local}) for degree {self.degree}; "
                f"got {self.cells.shape}."
            )
        if self.n_cells == 0 or self.n_cells % 2:
            raise ValueError(
                "A closed surface has an even, positive number of triangles; "
                f"got {self.n_cells}. Run `check_surface` to see what is missing."
            )
        if not isinstance(self.cells, Tracer):
            _check_numbering(np.asarray(self.cells), self.degree, self.n_nodes, self.n_vertices)

    @property
    def n_cells(self) -> int:
        """Number of triangles."""
        return self.cells.shape[0]

    @property
    def n_edges(self) -> int:
        """Number of edges."""
        return 3 * self.n_cells // 2

    @property
    def n_vertices(self) -> int:
        """Number of corners of triangles: nodes 0, ..., n_vertices - 1."""
        per_cell = n_local_nodes(self.degree) - 3 * self.degree
        return self.n_nodes - (self.degree - 1) * self.n_edges - per_cell * self.n_cells

    @property
    def n_node_pairs(self) -> int:
        """Ordered pairs of nodes of a common triangle: what a matrix has blocks for."""
        # Pairs on a common edge belong to two triangles, and a vertex with itself to many.
        in_cells, on_edges = self.cells.shape[1] ** 2, (self.degree + 1) ** 2
        return in_cells * self.n_cells - on_edges * self.n_edges + self.n_vertices

    @property
    def triangles(self) -> Int[Array, "cells 3"]:
        """The three vertices of every triangle."""
        return self.cells[:, :3]

    @property
    def euler_characteristic(self) -> int:
        """Vertices − edges + triangles: 2 for a sphere, 0 for a torus."""
        return self.n_vertices - self.n_edges + self.n_cells

    @property
    def genus(self) -> int:
        """Number of handles, summed over the components."""
        pieces = n_pieces(np.asarray(self.triangles), self.n_vertices)
        return pieces - self.euler_characteristic // 2


def _check_numbering(cells: np.ndarray, degree: int, n_nodes: int, n_vertices: int) -> None:
    """Raise unless `cells` numbers the nodes of a closed oriented surface as promised."""
    used = np.unique(cells)
    if used[-1] >= n_nodes:
        raise ValueError(f"`cells` names node {used[-1]}, but there are only {n_nodes} nodes.")
    if len(used) < n_nodes:
        missing = np.setdiff1d(np.arange(n_nodes), used)
        raise ValueError(
            f"{len(missing)} nodes belong to no triangle, the first ones are "
            f"{missing[:10].tolist()}. Remove them."
        )
    triangles = cells[:, :3]
    if np.any(triangles == np.roll(triangles, 1, axis=1)):
        raise ValueError("A triangle names the same vertex twice. Run `check_surface`.")
    edge = edges(triangles)
    n_torn = len(torn_edges(triangles, edge))
    if np.any(edge.n_cells != 2) or n_torn:
        raise ValueError(
            f"{np.count_nonzero(edge.n_cells != 2)} edges do not have two triangles and {n_torn} "
            "have two triangles of opposite orientation. The surface must be closed and "
            "oriented; `check_surface` lists these edges."
        )
    if triangles.max() >= n_vertices or (degree > 1 and cells[:, 3:].min() < n_vertices):
        raise ValueError("The vertices of the triangles must be numbered before all other nodes.")
    inside = cells[:, 3 : 3 * degree].reshape(len(cells), 3, degree - 1)
    inside = np.where(edge.is_forward[..., None], inside, inside[..., ::-1])
    of_edge = np.empty((len(edge.vertices), degree - 1), dtype=cells.dtype)
    of_edge[edge.of_cell] = inside
    wrong = np.flatnonzero(np.any(of_edge[edge.of_cell] != inside, axis=(1, 2)))
    if len(wrong):
        raise ValueError(
            f"{len(wrong)} triangles do not share the nodes inside an edge with their neighbour, "
            f"the first ones are {wrong[:10].tolist()}. Nodes inside an edge run from its first "
            "to its second vertex."
        )

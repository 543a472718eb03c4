"""New triangles of wanted sizes on the same curved surface.

Edges that are too long are split, too short ones collapsed, others flipped towards six neighbours
at every vertex; vertices slide into the middle of their neighbours and back onto the old surface.

??? cite "Reference"
    Botsch, Kobbelt (2004), *A remeshing approach to multiresolution modeling*, Symposium on
    Geometry Processing, 185–192, section 4.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..reference import lagrange_basis, lagrange_nodes
from ._adjacency import directed_edges, lagrange_cells, scatter
from ._check import lowest_normal_cosine
from ._closest import feet
from ._lifting import charts
from ._noise import vertex_areas
from ._quality import areas
from ._refine import raise_degree
from ._stencils import max_normals
from ._surface_mesh import SurfaceMesh
from ._triangulation import Triangulation

PASSES, RELAXATIONS = 8, 3
# An edge is split above this many times its size, and collapsed below.
LONG, SHORT = 4 / 3, 4 / 5
# More triangles than these are asked for by mistake.
MOST_TRIANGLES = 500_000
# Angle that an edge of a size by curvature subtends, and how fast sizes may grow along an edge.
BEND, GROWTH, SWEEPS = 0.35, 0.25, 60


class Remeshed(NamedTuple):
    """A new mesh on an old surface.

    **Attributes:**

    - `mesh`, `x`: the new mesh, of the degree of the old one, and its nodes, which lie on the old
      surface.
    - `old`: the old mesh.
    - `cell`, `xi`: in which old triangle every new node lies, and where in it.
    """

    mesh: SurfaceMesh
    x: Float[Array, "new_nodes 3"]
    old: SurfaceMesh
    cell: Int[np.ndarray, " new_nodes"]
    xi: Float[np.ndarray, "new_nodes 2"]

    def transfer(self, u: Float[Array | np.ndarray, "nodes ..."]) -> Float[Array, "new_nodes ..."]:
        """Nodal values of a field on the old mesh, at the nodes of the new one.

        Nothing is conserved but the values: the integral of the field changes by the error of its
        interpolation.
        """
        basis = lagrange_basis(self.old.degree, self.xi)
        local = jnp.asarray(u)[np.asarray(self.old.cells)[self.cell]]
        return jnp.einsum("pl,pl...->p...", basis, local)


def remesh(
    mesh: SurfaceMesh,
    x: Float[Array | np.ndarray, "nodes 3"],
    size: float | Float[Array | np.ndarray, " vertices"] | None = None,
) -> Remeshed:
    """A mesh of nearly equilateral triangles on the same surface.

    **Arguments:**

    - `mesh`, `x`: a closed surface of any degree. A surface of flat triangles is taken for the
      smooth one through its vertices, as in `raise_degree`.
    - `size`: wanted length of edges: a number, or one for every vertex, such as
      `size_by_curvature` gives. Left out: that of the same number of equilateral triangles.

    **Returns:** a `Remeshed`; its nodes lie on the old surface, and `transfer` takes fields along.
    Area and volume change by the error of interpolation only.

    **Raises:** `ValueError` for sizes that are not positive, or ask for more than 500,000
    triangles; `RuntimeError` where the new curved triangles would fold over: the sizes are too
    large for the bends of the surface.

    *Limits:* not differentiable, and not for use inside `jit`. Python loops over edges: about two
    seconds for 5,000 triangles. Creases are not kept.

    ```python
    new = jw.mesh.remesh(mesh, x, jw.mesh.size_by_curvature(mesh, x))
    c = new.transfer(c)
    ```

    ??? cite "Reference"
        Botsch, Kobbelt (2004), Symposium on Geometry Processing, 185–192, section 4.
    """
    points = np.asarray(x, dtype=np.float64)
    curved, nodes = (mesh, points) if mesh.degree > 1 else raise_degree(mesh, points, 3)
    surface = np.asarray(curved.cells), np.asarray(nodes)
    triangles, vertices = np.asarray(mesh.triangles), points[: mesh.n_vertices]
    sizes = _checked_sizes(triangles, vertices, size)
    field, found = _interpolant(curved, sizes), feet(*surface, vertices)
    for _ in range(PASSES):
        triangles, vertices = _changed(triangles, vertices, sizes)
        for _ in range(RELAXATIONS):
            vertices = _relaxed(triangles, vertices)
            found = feet(*surface, vertices)
            vertices = _position(surface, curved.degree, found)
        sizes = field(found)
    return _finished(mesh, curved, surface, triangles, vertices)


def size_by_curvature(
    mesh: SurfaceMesh,
    x: Float[Array | np.ndarray, "nodes 3"],
    bend: float = BEND,
    *,
    smallest: float | None = None,
    largest: float | None = None,
) -> Float[np.ndarray, " vertices"]:
    """Lengths of edges that follow the larger principal curvature, for `remesh`.

    **Arguments:**

    - `bend`: angle in radians by which the surface turns along an edge.
    - `smallest`, `largest`: limits of the lengths; left out, a third of the mean edge and three
      times that.

    **Returns:** one length for every vertex; it grows by at most a quarter of the distance.
    """
    if not 0 < bend < 2:
        raise ValueError(f"`bend` must be between 0 and 2 radians; got {bend}.")
    triangles = np.asarray(mesh.triangles)
    vertices = np.asarray(x, dtype=np.float64)[: mesh.n_vertices]
    mean = _edge_of(triangles, vertices)
    low = mean / 3 if smallest is None else smallest
    high = 3 * mean if largest is None else largest
    if not 0 < low <= high:
        raise ValueError(f"`smallest` must be positive and at most `largest`; got {low}, {high}.")
    local = charts(triangles, vertices)
    # Second derivatives of the height in u², uv and v², over the reach.
    uu, uv, vv = (local.coefficients[:, k] / local.reach for k in (2, 3, 4))
    largest_curvature = np.abs(uu + vv) + np.sqrt((uu - vv) ** 2 + uv**2)
    sizes = np.clip(bend / np.maximum(largest_curvature, bend / high), low, high)
    start, end = directed_edges(triangles).reshape(-1, 2).T
    distance = np.linalg.norm(vertices[start] - vertices[end], axis=1)
    for _ in range(SWEEPS):
        before = sizes.copy()
        np.minimum.at(sizes, end, before[start] + GROWTH * distance)
        np.minimum.at(sizes, start, before[end] + GROWTH * distance)
        if np.array_equal(before, sizes):
            break
    return sizes


def _edge_of(triangles, vertices) -> float:
    """Edge of equilateral triangles of the mean area."""
    return math.sqrt(4 / math.sqrt(3) * float(np.mean(areas(vertices[triangles]))))


def _checked_sizes(triangles, vertices, size) -> Float[np.ndarray, " vertices"]:
    if size is None:
        size = _edge_of(triangles, vertices)
    sizes = np.asarray(size, dtype=np.float64)
    if sizes.ndim == 0:
        sizes = np.full(len(vertices), float(sizes))
    if sizes.shape != (len(vertices),):
        raise ValueError(
            f"`size` must be one number, or one for each of {len(vertices)} vertices; "
            f"got shape {sizes.shape}."
        )
    if not np.all(np.isfinite(sizes)) or np.min(sizes) <= 0:
        raise ValueError(f"`size` must be positive and finite; got {np.min(sizes)} at least.")
    count = float(np.sum(vertex_areas(triangles, vertices) / sizes**2)) * 4 / math.sqrt(3)
    if count > MOST_TRIANGLES:
        raise ValueError(
            f"`size` asks for about {count:.2g} triangles, more than {MOST_TRIANGLES:,}; "
            f"the mean edge of the present mesh is {_edge_of(triangles, vertices):.3g}."
        )
    return sizes


def _interpolant(curved: SurfaceMesh, sizes):
    """Sizes at points of the old surface, linear between its vertices."""
    corners = np.asarray(curved.triangles)

    def at(found):
        return np.einsum("pc,pc->p", lagrange_basis(1, found.xi), sizes[corners[found.cell]])

    return at


def _changed(triangles, vertices, sizes):
    """One pass of splits, collapses and flips."""
    changing = Triangulation(triangles, vertices)
    wanted = list(map(float, sizes))
    for a, b in changing.edges():
        target = min(wanted[a], wanted[b])
        if changing.length(a, b) > LONG * target:
            changing.split(a, b)
            wanted.append(0.5 * (wanted[a] + wanted[b]))
    for a, b in changing.edges():
        if not changing.valence(a) or not changing.valence(b):
            continue
        target = min(wanted[a], wanted[b])
        if changing.length(a, b) < SHORT * target and changing.are_joined(a, b):
            changing.collapse(a, b, LONG * target)
    for a, b in changing.edges():
        changing.flip(a, b)
    return changing.arrays()


def _relaxed(triangles, vertices):
    """Vertices half-way towards the middle of their neighbours, within the tangent plane."""
    weights = vertex_areas(triangles, vertices)
    total, mass = np.zeros_like(vertices), np.zeros(len(vertices))
    start, end = directed_edges(triangles).reshape(-1, 2).T
    np.add.at(total, start, weights[end, None] * vertices[end])
    np.add.at(mass, start, weights[end])
    away = total / mass[:, None] - vertices
    normals = max_normals(triangles, vertices)
    away -= np.sum(away * normals, axis=1, keepdims=True) * normals
    return vertices + 0.5 * away


def _position(surface, degree: int, found) -> Float[np.ndarray, "points 3"]:
    cells, nodes = surface
    return np.einsum("pl,pld->pd", lagrange_basis(degree, found.xi), nodes[cells[found.cell]])


def _finished(old: SurfaceMesh, curved: SurfaceMesh, surface, triangles, vertices) -> Remeshed:
    """All nodes of the degree of the old mesh on its surface."""
    cells, n_nodes = lagrange_cells(triangles, len(vertices), old.degree)
    flat = np.einsum(
        "qc,tcd->tqd", lagrange_basis(1, lagrange_nodes(old.degree)), vertices[triangles]
    )
    found = feet(surface[0], surface[1], scatter(cells, n_nodes, flat))
    x = _position(surface, curved.degree, found)
    mesh = SurfaceMesh(cells, old.degree, n_nodes)
    folded = int(np.count_nonzero(lowest_normal_cosine(mesh, x) <= 0))
    if folded:
        raise RuntimeError(
            f"{folded} new triangles would fold over: the surface bends too much for triangles of "
            "this size. Ask for a smaller `size`, or for `size_by_curvature`."
        )
    return Remeshed(mesh, jnp.asarray(x), old, found.cell, found.xi)

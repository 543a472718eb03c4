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
from ._closest import Search, lattice
from ._lifting import charts
from ._noise import vertex_areas
from ._quality import areas
from ._refine import raise_degree
from ._stencils import max_normals
from ._surface_mesh import SurfaceMesh
from ._triangulation import Triangulation

PASSES, RELAXATIONS, COUNTINGS = 8, 3, 4
# An edge is split above this many times its size, and collapsed below.
LONG, SHORT = 4 / 3, 4 / 5
# More triangles than these are asked for by mistake.
MOST_TRIANGLES = 500_000
# Angle that an edge of a size by curvature subtends, and how fast sizes may grow along an edge.
BEND, GROWTH, SWEEPS = 0.35, 0.25, 60
# Up to this degree the kinks between triangles tell, and surfaces are lifted to that one.
FLAT, LIFTED = 2, 3


class Remeshed(NamedTuple):
    """A new mesh on an old surface.

    **Attributes:**

    - `mesh`, `x`: the new mesh, of the degree of the old one, and its nodes, which lie on the
      smooth surface through the old ones.
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
    *,
    n_vertices: int | None = None,
) -> Remeshed:
    """A mesh of nearly equilateral triangles on the same surface.

    **Arguments:**

    - `mesh`, `x`: a closed surface of any degree. One of degree 1 or 2 is taken for the smooth one
      through its nodes, as in `raise_degree`: its own kinks between triangles would be curvature
      on a new mesh.
    - `size`: wanted length of edges: a number, or one for every vertex, such as
      `size_by_curvature` gives. Left out: that of the same number of equilateral triangles.
    - `n_vertices`: how many vertices the new mesh has, exactly. All lengths of `size` are scaled by
      one factor to make so many. With the number of the old mesh, arrays keep their shapes, and
      nothing that was compiled for these is compiled again.

    **Returns:** a `Remeshed`; `transfer` takes fields along. Area and volume change by the error of
    interpolation only; `surface.restored` brings them back.

    **Raises:** `ValueError` for sizes that are not positive, or ask for more than 500,000
    triangles, and for fewer vertices than a surface of this genus has; `RuntimeError` where the new
    curved triangles would fold over: the sizes are too large for the bends of the surface.

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
    old = _Smooth(mesh, points)
    triangles, vertices = np.asarray(mesh.triangles), points[: mesh.n_vertices]
    sizes = _checked_sizes(mesh, vertices, size, n_vertices)
    field, found = _interpolant(mesh, sizes), old.feet(vertices)
    for _ in range(PASSES):
        triangles, vertices = _changed(triangles, vertices, sizes)
        for _ in range(RELAXATIONS):
            vertices = _relaxed(triangles, vertices)
            found = old.feet(vertices)
            vertices = found.x
        sizes = field(found)
    if n_vertices is not None:
        for _ in range(COUNTINGS):
            triangles, vertices = _counted(triangles, vertices, field(found), n_vertices)
            found = old.feet(_relaxed(triangles, vertices))
            vertices = found.x
    return _finished(mesh, old, triangles, vertices, n_vertices)


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


def _checked_sizes(mesh, vertices, size, n_vertices) -> Float[np.ndarray, " vertices"]:
    triangles = np.asarray(mesh.triangles)
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
    if n_vertices is not None:
        least = 4 if mesh.genus == 0 else 10 * mesh.genus
        if n_vertices < least:
            raise ValueError(
                f"`n_vertices` must be at least {least} for this surface; got {n_vertices}."
            )
        wanted = 2 * (n_vertices - 2 + 2 * mesh.genus)
        sizes, count = sizes * math.sqrt(count / wanted), wanted
    if count > MOST_TRIANGLES:
        raise ValueError(
            f"`size` or `n_vertices` asks for about {count:.2g} triangles, more than "
            f"{MOST_TRIANGLES:,}; the mean edge of the present mesh is "
            f"{_edge_of(triangles, vertices):.3g}."
        )
    return sizes


class _Feet(NamedTuple):
    """Points of the smooth surface, and where in the triangles of the mesh they belong to."""

    x: Float[np.ndarray, "points 3"]
    cell: Int[np.ndarray, " points"]
    xi: Float[np.ndarray, "points 2"]


class _Smooth:
    """The smooth surface through the nodes of a mesh.

    The nodes of a triangle of degree 2 are the vertices of four flat ones, and these are lifted.
    """

    def __init__(self, mesh: SurfaceMesh, x: Float[np.ndarray, "nodes 3"]):
        n = mesh.degree if mesh.degree <= FLAT else 1
        self._corners, pieces = lattice(n)
        if mesh.degree <= FLAT:
            # Nodes stand in another order than points of the lattice.
            at = lagrange_nodes(mesh.degree)[:, None] - self._corners[None]
            node = np.argmin(np.sum(at**2, axis=-1), axis=0)
            flat = np.asarray(mesh.cells)[:, node[pieces]].reshape(-1, 3)
            curved, nodes = raise_degree(flat, x, LIFTED)
        else:
            curved, nodes = mesh, x
        self._pieces, self._degree = pieces, curved.degree
        self._cells, self._nodes = np.asarray(curved.cells), np.asarray(nodes)
        self._search = Search(self._cells, self._nodes)

    def feet(self, queries: Float[np.ndarray, "points 3"]) -> _Feet:
        """The nearest points."""
        found = self._search.feet(queries)
        local = self._nodes[self._cells[found.cell]]
        x = np.einsum("pl,pld->pd", lagrange_basis(self._degree, found.xi), local)
        cell, piece = np.divmod(found.cell, len(self._pieces))
        corners = self._corners[self._pieces[piece]]
        return _Feet(x, cell, np.einsum("pc,pci->pi", lagrange_basis(1, found.xi), corners))


def _interpolant(mesh: SurfaceMesh, sizes):
    """Sizes at points of the old surface, linear between its vertices."""
    corners = np.asarray(mesh.triangles)

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


def _counted(triangles, vertices, sizes, n_vertices: int):
    """The longest edges split or the shortest collapsed, against their sizes, to an exact number.

    No two of them share a vertex, so that changes are spread over the surface.
    """
    changing, left = Triangulation(triangles, vertices), n_vertices - len(vertices)

    def relative(edge):
        return changing.length(*edge) / (sizes[edge[0]] + sizes[edge[1]])

    touched: set[int] = set()
    for a, b in sorted(changing.edges(), key=relative, reverse=left > 0):
        if left == 0:
            break
        if a in touched or b in touched or not changing.are_joined(a, b):
            continue
        around = changing.neighbours(a) | changing.neighbours(b)
        if left > 0:
            changing.split(a, b)
        elif not changing.collapse(a, b, math.inf):
            continue
        touched |= around
        left -= 1 if left > 0 else -1
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


def _finished(old: SurfaceMesh, smooth: _Smooth, triangles, vertices, n_vertices) -> Remeshed:
    """All nodes of the degree of the old mesh on its surface."""
    if n_vertices not in (None, len(vertices)):
        raise RuntimeError(
            f"The new mesh has {len(vertices)} vertices, and no sound change gives {n_vertices}; "
            "ask for more."
        )
    cells, n_nodes = lagrange_cells(triangles, len(vertices), old.degree)
    flat = np.einsum(
        "qc,tcd->tqd", lagrange_basis(1, lagrange_nodes(old.degree)), vertices[triangles]
    )
    found = smooth.feet(scatter(cells, n_nodes, flat))
    x = found.x
    mesh = SurfaceMesh(cells, old.degree, n_nodes)
    folded = int(np.count_nonzero(lowest_normal_cosine(mesh, x) <= 0))
    if folded:
        raise RuntimeError(
            f"{folded} new triangles would fold over: the surface bends too much for triangles of "
            "this size. Ask for a smaller `size`, or for `size_by_curvature`."
        )
    return Remeshed(mesh, jnp.asarray(x), old, found.cell, found.xi)

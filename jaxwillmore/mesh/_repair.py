"""Repairs of a triangulation, each by name and each told; nothing is repaired unasked."""

from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ._arrays import clean_faces, clean_vertices, finding
from ._quality import areas
from ._report import SurfaceError, SurfaceReport
from ._topology import repeated_corners, repeats_of_faces, unused_vertices, vertex_pieces

Vertices = Float[np.ndarray, "vertices 3"]
Faces = Int[np.ndarray, "faces 3"]

_MOST_NEIGHBOURS = 100  # vertices that one vertex is merged with, on average
_SHOWN = 10


class Repaired(NamedTuple):
    """A triangulation, and what was done to it, a sentence for every act."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    acts: tuple[str, ...]


def repair(
    vertices,
    faces,
    *,
    merge: float | None = None,
    collapsed: bool = True,
    repeated: bool = True,
    keep: Literal["largest"] | None = None,
    components: int = 1,
    smallest_piece: float = 0.0,
    unused: bool = True,
    outward: bool = True,
) -> Repaired:
    """Mend what `check_surface` finds and a program can mend; everything done is listed.

    The order is that of the arguments. Places do not change, and no face is added: holes, sheets
    that touch and pieces inside each other stay for `check_surface` to refuse.

    **Arguments:**

    - `vertices`, `faces`: arrays as for `check_surface`; they are not changed.
    - `merge`: make one vertex of vertices at most this far apart, in chains; the first one stays.
    - `collapsed`: drop faces that name a vertex twice.
    - `repeated`: drop faces with the same three vertices as an earlier one.
    - `keep`: `"largest"` keeps the `components` pieces with the largest areas.
    - `smallest_piece`: drop pieces with less than this part of the area of the largest one.
    - `unused`: drop vertices without a face.
    - `outward`: turn faces over until neighbours agree and every piece encloses a positive volume.

    **Raises:** `SurfaceError` for arrays that are no triangulation at all, and where `merge` is so
    large that it would make one vertex of whole regions.

    ```python
    vertices, faces, acts = jw.mesh.repair(vertices, faces, keep="largest")
    ```
    """
    if keep not in (None, "largest"):
        raise ValueError(f'`keep` must be "largest" or None; got {keep!r}.')
    x, triangles = _arrays(vertices, faces)
    acts: list[str] = []
    if merge is not None:
        merged, triangles = merge_vertices(x, triangles, merge)
        if len(merged) < len(x):
            n = len(x) - len(merged)
            acts.append(f"made one of vertices at most {merge:g} apart: {n} fewer")
        x = merged
    if collapsed:
        bad = repeated_corners(triangles)
        _tell(acts, "dropped faces that name a vertex twice ({n}): {which}", np.flatnonzero(bad))
        triangles = triangles[~bad]
    if repeated and len(triangles):
        bad = repeats_of_faces(triangles)
        _tell(acts, "dropped faces that repeat an earlier one ({n}): {which}", np.flatnonzero(bad))
        triangles = triangles[~bad]
    if len(triangles) and (keep is not None or smallest_piece > 0):
        most = components if keep == "largest" else len(triangles)
        x, triangles = _keep_pieces(x, triangles, most, smallest_piece, acts)
    if unused:
        bad = unused_vertices(triangles, len(x))
        _tell(acts, "dropped vertices without a face ({n}): {which}", bad)
        x, triangles = _without(x, triangles, bad)
    if outward and len(triangles):
        turned = orient(x, triangles)
        changed = np.flatnonzero(np.any(turned != triangles, axis=1))
        _tell(acts, "turned faces over ({n}): {which}", changed)
        triangles = turned
    return Repaired(x, triangles, tuple(acts))


def _arrays(vertices: Any, faces: Any) -> tuple[Vertices, Faces]:
    """Both as arrays, or a complaint."""
    points, found = clean_vertices(vertices)
    triangles, more = (None, []) if points is None else clean_faces(faces, len(points))
    found = [f for f in [*found, *more] if f.severity == "error"]
    if points is not None and not np.all(np.isfinite(points)):
        bad = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
        text = "These vertices have a coordinate that is NaN or infinite."
        found.append(finding("non_finite_coordinates", bad, text, "Repair the source."))
    if points is None or triangles is None or found:
        n = 0 if points is None else len(points)
        report = SurfaceReport(tuple(found), n, 0)
        raise SurfaceError(str(report), report)
    return points, triangles


def _tell(acts: list[str], words: str, which: Int[np.ndarray, " some"]) -> None:
    """Add an act, if there was one."""
    if len(which):
        more = " and more" if len(which) > _SHOWN else ""
        shown = ", ".join(map(str, which[:_SHOWN].tolist())) + more
        acts.append(words.format(n=len(which), which=shown))


def _keep_pieces(
    x: Vertices, triangles: Faces, most: int, smallest: float, acts: list[str]
) -> tuple[Float[np.ndarray, "kept 3"], Int[np.ndarray, "kept_faces 3"]]:
    """The pieces with the largest areas, and none of the vertices of the others."""
    labels = vertex_pieces(triangles, len(x))
    names, piece = np.unique(labels[triangles[:, 0]], return_inverse=True)
    area = np.bincount(piece, areas(x[triangles]))
    order = np.argsort(-area, kind="stable")
    kept = order[:most][area[order[:most]] >= smallest * area.max()]
    stays = np.isin(piece, kept)
    if np.all(stays):
        return x, triangles
    gone = np.setdiff1d(np.unique(triangles[~stays]), np.unique(triangles[stays]))
    acts.append(
        f"dropped {len(names) - len(kept)} of {len(names)} pieces: {len(gone)} vertices and "
        f"{np.count_nonzero(~stays)} faces, {1 - area[kept].sum() / area.sum():.2g} of the area"
    )
    return _without(x, triangles[stays], gone)


def _without(
    x: Vertices, triangles: Faces, dropped: Int[np.ndarray, " some"]
) -> tuple[Float[np.ndarray, "kept 3"], Faces]:
    """Leave out vertices that no face names, and number the others again."""
    stays: Bool[np.ndarray, " vertices"] = np.ones(len(x), dtype=bool)
    stays[dropped] = False
    return x[stays], (np.cumsum(stays) - 1)[triangles]


def _labels(start: np.ndarray, end: np.ndarray, n: int) -> Int[np.ndarray, " n"]:
    graph = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def merge_vertices(
    vertices: Vertices, faces: Faces, tolerance: float
) -> tuple[Float[np.ndarray, "merged 3"], Faces]:
    """Make one vertex of vertices at most `tolerance` apart, in chains; the first of each stays."""
    if tolerance == 0:
        label = np.unique(vertices + 0.0, axis=0, return_inverse=True)[1].ravel()
    else:
        tree = KDTree(vertices)
        if tree.count_neighbors(tree, tolerance) > _MOST_NEIGHBOURS * len(vertices):
            raise SurfaceError(
                f"Most vertices have more than {_MOST_NEIGHBOURS} others within {tolerance:g}: "
                "merging them would leave no surface. Lower the tolerance."
            )
        pairs = tree.query_pairs(tolerance, output_type="ndarray")
        label = _labels(pairs[:, 0], pairs[:, 1], len(vertices))
    _, first, new = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[new][faces]


def orient(vertices: Vertices, faces: Faces) -> Faces:
    """Turn faces over until neighbours agree and every component encloses a positive volume.

    A surface that cannot be oriented comes back with the contradictions it must have.
    """
    n = len(faces)
    start, end = faces, np.roll(faces, -1, axis=1)
    low, high = np.minimum(start, end).ravel(), np.maximum(start, end).ravel()
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    one, two = order[:-1][same], order[1:][same]
    agree = (start < end).ravel()[one] != (start < end).ravel()[two]
    # Two copies of every face, as given (f) and turned over (n + f); an edge joins the copies
    # that agree. The copies joined to a component's first face are its oriented version.
    one, two = one // 3, two // 3
    partner = np.where(agree, two, n + two)
    mirror = np.where(agree, n + two, two)
    label = _labels(np.concatenate([one, n + one]), np.concatenate([partner, mirror]), 2 * n)
    # both copies of a component share the smaller of their two labels
    component = np.minimum(label[:n], label[n:])
    turned = label[:n] != component
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    volume = np.bincount(component, weights=np.sum(a * np.cross(b, c), axis=1))
    return np.where((volume[component] < 0)[:, None], faces[:, ::-1], faces)

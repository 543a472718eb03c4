"""Find and name everything that keeps a triangulation from being a closed oriented surface."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..reference import lagrange_gradients
from ._adjacency import edges
from ._arrays import clean_faces, clean_vertices, finding
from ._defects import (
    expectations,
    faces_by_themselves,
    how_faces_join,
    piercing,
    roughness,
    shape,
    unmerged,
)
from ._report import SurfaceReport
from ._surface_mesh import SurfaceMesh
from ._topology import n_pieces, repeated_corners, repeats_of_faces


def check_surface(
    vertices,
    faces,
    *,
    components: int = 1,
    genus: int | None = None,
    self_intersections: bool = True,
) -> SurfaceReport:
    """Everything that is wrong with a triangulated surface, by name; nothing is repaired.

    **Arguments:**

    - `vertices`: whatever should be an array of shape (n, 3).
    - `faces`: whatever should be an integer array of shape (m, 3).
    - `components`: how many separate pieces there should be.
    - `genus`: how many handles there should be, if that is known.
    - `self_intersections`: whether to look for triangles that pierce each other. This is the
      slowest part; it runs only when there is no error.

    **Returns:** a `SurfaceReport`; print it, ask `report.ok`, or call `report.raise_if_bad()`.

    *Limits:* self-intersections within a plane or between triangles with a common vertex are not
    found, other than as folded edges.

    ```python
    report = jw.mesh.check_surface(vertices, faces)
    print(report)
    ```
    """
    points, found = clean_vertices(vertices)
    if points is None:
        return SurfaceReport(tuple(found), 0, 0)
    n_vertices = len(points)
    triangles, more = clean_faces(faces, n_vertices)
    found += more
    if triangles is None:
        return SurfaceReport(tuple(found), n_vertices, 0)
    numbers: dict[str, Any] = {}
    not_finite = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
    if len(not_finite):
        text = "These vertices have a coordinate that is NaN or infinite."
        found.append(finding("non_finite_coordinates", not_finite, text, "Repair the source."))
    found += faces_by_themselves(triangles, n_vertices)
    # Repeated and collapsed faces have been named; what they do to the edges would only repeat it.
    proper = np.flatnonzero(~repeated_corners(triangles))
    proper = proper[~repeats_of_faces(triangles[proper])]
    clean = triangles[proper]
    edge = edges(clean)
    if len(clean):
        if not len(not_finite):
            found += unmerged(points, clean, edge)
        found += how_faces_join(clean, proper, edge)
        numbers["n_components"] = n_pieces(clean, n_vertices)
        numbers["euler_characteristic"] = len(np.unique(clean)) - len(edge.vertices) + len(clean)
        found += expectations(clean, n_vertices, numbers, components, genus, found)
    if len(clean) and not len(not_finite):
        more, geometry = shape(points, clean, proper, edge, found)
        found += more
        numbers |= geometry
        if not any(f.severity == "error" for f in found):
            more, numbers["scatter"] = roughness(points, clean)
            found += more
            if self_intersections:
                found += piercing(points, clean)
    return SurfaceReport(tuple(found), n_vertices, len(triangles), **numbers)


def check_mesh(
    mesh: SurfaceMesh, x: Float[Array | np.ndarray, "nodes 3"], **options
) -> SurfaceReport:
    """As `check_surface` for a mesh of any degree, whose curved triangles are looked at as well.

    A curved triangle is inverted where its normal, at one of (2k + 1)(k + 1) points of it for
    degree k, points away from the flat triangle's: a node of higher degree lies far from where it
    belongs, or the nodes are numbered in another order.
    """
    n_vertices = mesh.n_vertices
    points = np.asarray(x, dtype=np.float64)
    report = check_surface(points[:n_vertices], np.asarray(mesh.triangles), **options)
    not_finite = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
    found = list(report.findings)
    if len(not_finite) and "non_finite_coordinates" not in report.kinds:
        text = "These nodes have a coordinate that is NaN or infinite."
        found.append(finding("non_finite_coordinates", not_finite, text, "Repair the source."))
    elif mesh.degree > 1 and not len(not_finite):
        cosine = lowest_normal_cosine(mesh, points)
        bad = np.argsort(cosine)[: np.count_nonzero(cosine <= 0)]
        if len(bad):
            text = "These curved triangles turn their normal by more than 90°, or fold over."
            advice = (
                "Check the positions and the local order of the nodes of higher degree "
                "(vertices, edges 0→1, 1→2, 2→0, interior), or use a finer mesh."
            )
            found.append(finding("inverted_elements", bad, text, advice))
    return report._replace(findings=tuple(found))


def lowest_normal_cosine(
    mesh: SurfaceMesh, x: Float[np.ndarray, "nodes 3"]
) -> Float[np.ndarray, " cells"]:
    """Per curved triangle the least cosine between its normal and that of its flat triangle."""
    corners = x[np.asarray(mesh.cells)]
    n = 2 * mesh.degree
    xi = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]) / n
    J = np.einsum("qla,tld->tqad", lagrange_gradients(mesh.degree, xi), corners)
    normal = np.cross(J[:, :, 0], J[:, :, 1])
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(flat, axis=-1)[:, None]
    cosine = np.einsum("tqd,td->tq", normal, flat) / np.where(length > 0, length, 1.0)
    return cosine.min(axis=1)

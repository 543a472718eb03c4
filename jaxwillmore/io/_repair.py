"""The two repairs a reader may ask for by name; nothing is repaired without being asked."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

Vertices = Float[np.ndarray, "vertices 3"]
Faces = Int[np.ndarray, "faces 3"]


def _labels(start: np.ndarray, end: np.ndarray, n: int) -> Int[np.ndarray, " n"]:
    graph = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def merge_vertices(
    vertices: Vertices, faces: Faces, tolerance: float
) -> tuple[Float[np.ndarray, "merged 3"], Faces]:
    """Make one vertex of vertices closer than `tolerance`, in chains; the first of each stays."""
    pairs = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
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

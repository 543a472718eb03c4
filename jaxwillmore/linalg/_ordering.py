"""Nested dissection from connectivity alone."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order

# Parts this small are numbered as they come. Larger leaves save time here and cost fill later.
LEAF = 8


def _levels(graph: sp.csr_matrix, start: int) -> tuple[np.ndarray, np.ndarray]:
    """Breadth-first order from `start` and the distance of every reached node."""
    order, parent = map(np.asarray, breadth_first_order(graph, start, directed=False))
    level = np.full(graph.shape[0], -1, np.int64)  # pyright: ignore[reportOptionalSubscript]
    level[start] = 0
    # Parents precede children, so one pass over whole layers fills the distances.
    pending = order[1:]
    while len(pending):
        known = level[parent[pending]] >= 0
        level[pending[known]] = level[parent[pending[known]]] + 1
        pending = pending[~known]
    return order, level


def _split(graph: sp.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two parts and the separator between them, as index arrays."""
    n = graph.shape[0]  # pyright: ignore[reportOptionalSubscript]
    order, _ = _levels(graph, 0)
    if len(order) < n:
        rest = np.setdiff1d(np.arange(n), order)
        return order, rest, np.empty(0, np.int64)
    # A second sweep from the farthest node finds a nearly longest path through the part.
    order, level = _levels(graph, int(order[-1]))
    counts = np.bincount(level)
    below = np.cumsum(counts) - counts
    # The smallest layer among those that leave at least a third on either side.
    balanced = (below >= n / 3) & (below + counts <= 2 * n / 3)
    candidates = np.flatnonzero(balanced)
    if len(candidates):
        cut = candidates[np.argmin(counts[candidates])]
    else:
        cut = int(np.searchsorted(np.cumsum(counts), n / 2))
    layer = np.flatnonzero(level == cut)
    # Only nodes of the layer that touch the far side separate; the others join the near side.
    touches = np.zeros(n, bool)
    far = level > cut
    touches[layer] = (graph[layer] @ far.astype(np.float64)) > 0
    return (
        np.flatnonzero((level < cut) | ((level == cut) & ~touches)),
        np.flatnonzero(far),
        np.flatnonzero(touches),
    )


def nested_dissection(graph: sp.csr_matrix) -> np.ndarray:
    """Elimination order with small fill for the graph of a surface mesh.

    George's automatic nested dissection: breadth-first layers from a peripheral node, the smallest
    layer near the middle as separator, both halves in the same way. On a closed surface with N
    nodes the factors hold O(N log N) entries.

    **Arguments:**

    - `graph`: symmetric pattern with entries 1, diagonal allowed.

    **Returns:**

    Node numbers in the order of elimination.

    ??? cite "Reference"
        George, Liu (1981), *Computer Solution of Large Sparse Positive Definite Systems*, ch. 8.
    """
    pieces: list[np.ndarray] = []
    # Depth first, separator before both halves; reversed at the end, so separators come last.
    stack = [np.arange(graph.shape[0])]  # pyright: ignore[reportOptionalSubscript]
    while stack:
        nodes = stack.pop()
        if len(nodes) <= LEAF:
            pieces.append(nodes)
            continue
        first, second, separator = _split(graph[nodes][:, nodes].tocsr())
        if len(first) == 0 or len(second) == 0:
            pieces.append(nodes)
            continue
        if len(separator):
            pieces.append(nodes[separator])
        stack += [nodes[first], nodes[second]]
    return np.concatenate(pieces[::-1])

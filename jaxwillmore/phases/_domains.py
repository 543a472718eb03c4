"""How many pieces a phase is in."""

import numpy as np
from jaxtyping import Array, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..mesh import SurfaceMesh
from ._lattice import neighbours


def domains(mesh: SurfaceMesh, c: Float[Array | np.ndarray, " nodes"], level: float = 0.5) -> int:
    """The number of connected regions in which c > `level`, as the nodes see them.

    Two nodes are neighbours when they are corners of one of the small triangles between the nodes
    of a cell. On the host; for the other phase pass 1 − c.

    *Limits:* a region between nodes is not seen, one that meets another in a single point counts as
    two or as one.
    """
    c, cells = np.asarray(c), np.asarray(mesh.cells)
    if c.shape != (mesh.n_nodes,):
        raise ValueError(
            f"`c` needs one number for each of the {mesh.n_nodes} nodes; got {c.shape}."
        )
    above = c > level
    i, j = cells[:, neighbours(mesh.degree)].reshape(-1, 2).T
    both = above[i] & above[j]
    graph = coo_array((np.ones(both.sum()), (i[both], j[both])), shape=(len(c), len(c)))
    _, labels = connected_components(graph, directed=False)
    return len(np.unique(labels[above]))

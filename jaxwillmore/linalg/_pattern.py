"""Block sparsity of a nodal system: which pairs of nodes share a cell. Computed once per mesh."""

import hashlib

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float, Int

from ._ordering import nested_dissection


class BlockPattern(eqx.Module):
    """Compressed-row pattern of node pairs; every pair carries a dense block of fields.

    All members are arrays: two meshes with the same counts share every compiled function.

    **Attributes:**

    - `indptr`, `cols`: compressed rows, columns sorted within a row.
    - `rows`: the row of every block.
    - `blocks`: for every cell and pair of its nodes, the block the pair adds to.
    - `order`: elimination order of the nodes (nested dissection), used by direct solvers.
    - `key`: 62-bit digest of the pattern; the host keeps symbolic data under it.
    """

    indptr: Int[Array, " rows_plus_1"]
    cols: Int[Array, " blocks"]
    rows: Int[Array, " blocks"]
    blocks: Int[Array, "cells local local"]
    order: Int[Array, " nodes"]
    key: Int[Array, ""]

    @property
    def n_nodes(self) -> int:
        """Number of block rows."""
        return self.order.shape[0]

    @property
    def n_blocks(self) -> int:
        """Number of node pairs stored."""
        return self.cols.shape[0]


def block_pattern(cells: Int[Array, "cells local"], n_nodes: int) -> BlockPattern:
    """Pattern of a system assembled cell by cell.

    **Arguments:**

    - `cells`: node numbers of every cell; concrete integers.
    - `n_nodes`: number of nodes; every node must belong to a cell.

    **Raises:** `ValueError` if a node belongs to no cell (its row would be empty and the matrix
    singular).
    """
    nodes = np.asarray(cells, dtype=np.int64)
    local = nodes.shape[1]
    if nodes.size == 0 or nodes.min() < 0 or nodes.max() >= n_nodes:
        raise ValueError(f"`cells` must hold node numbers in 0..{n_nodes - 1}.")
    pairs = (nodes[:, :, None] * n_nodes + nodes[:, None, :]).reshape(-1)
    unique, blocks = np.unique(pairs, return_inverse=True)
    rows, cols = np.divmod(unique, n_nodes)
    counts = np.bincount(rows, minlength=n_nodes)
    if np.any(counts == 0):
        lost = np.flatnonzero(counts == 0)[:10].tolist()
        raise ValueError(f"Nodes {lost} belong to no cell; remove them from the mesh.")
    indptr = np.concatenate([[0], np.cumsum(counts)])
    graph = sp.csr_matrix((np.ones(len(cols), np.int8), cols, indptr), shape=(n_nodes, n_nodes))
    digest = hashlib.sha256(indptr.tobytes() + cols.tobytes()).digest()[:8]
    return BlockPattern(
        indptr=jnp.asarray(indptr, jnp.int32),
        cols=jnp.asarray(cols, jnp.int32),
        rows=jnp.asarray(rows, jnp.int32),
        blocks=jnp.asarray(blocks.reshape(-1, local, local), jnp.int32),
        order=jnp.asarray(nested_dissection(graph), jnp.int32),
        key=jnp.asarray(int.from_bytes(digest, "little") >> 2, jnp.int64),
    )


def scatter_blocks(
    pattern: BlockPattern, local: Float[Array, "cells local local fields fields"]
) -> Float[Array, "blocks fields fields"]:
    """Sum cell matrices into the blocks of the pattern."""
    zero = jnp.zeros((pattern.n_blocks, *local.shape[3:]), local.dtype)
    return zero.at[pattern.blocks].add(local)

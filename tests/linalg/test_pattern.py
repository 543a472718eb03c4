"""The block pattern of a mesh, and the scatter of cell matrices into it."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.linalg import block_pattern, scatter_blocks
from jaxwillmore.mesh import icosphere


@pytest.mark.parametrize("degree", [1, 2])
def test_the_pattern_holds_every_pair_of_nodes_of_a_cell_once(degree):
    mesh, _ = icosphere(0, degree)
    pattern = block_pattern(mesh.cells, mesh.n_nodes)
    pairs = {(int(i), int(j)) for cell in np.asarray(mesh.cells) for i in cell for j in cell}
    stored = list(zip(pattern.rows.tolist(), pattern.cols.tolist(), strict=True))
    assert stored == sorted(pairs)  # row by row, columns rising: compressed rows
    counts = np.diff(np.asarray(pattern.indptr))
    np.testing.assert_array_equal(np.repeat(np.arange(mesh.n_nodes), counts), pattern.rows)
    assert pattern.n_nodes == mesh.n_nodes and pattern.n_blocks == len(pairs)


def test_scatter_adds_cell_matrices_where_they_belong():
    mesh, _ = icosphere(0, 2)
    pattern = block_pattern(mesh.cells, mesh.n_nodes)
    cells, local, fields = np.asarray(mesh.cells), mesh.cells.shape[1], 2
    blocks = jr.normal(jr.key(0), (mesh.n_cells, local, local, fields, fields))
    expected = np.zeros((mesh.n_nodes, mesh.n_nodes, fields, fields))
    np.add.at(expected, (cells[:, :, None], cells[:, None, :]), np.asarray(blocks))
    data = scatter_blocks(pattern, blocks)
    found = np.zeros_like(expected)
    found[np.asarray(pattern.rows), np.asarray(pattern.cols)] = data
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_equal_meshes_share_a_key_and_different_ones_do_not():
    (a, _), (b, _), (c, _) = icosphere(0, 1), icosphere(0, 1, 2.0), icosphere(0, 2)
    keys = [int(block_pattern(m.cells, m.n_nodes).key) for m in (a, b, c)]
    assert keys[0] == keys[1] != keys[2]
    assert all(0 <= key < 2**62 for key in keys)
    turned = block_pattern(jnp.roll(a.cells, 1, axis=1), a.n_nodes)
    assert int(turned.key) == keys[0]  # the same pairs in another local order


def test_nodes_without_cells_and_bad_numbers_are_named():
    cells = jnp.array([[0, 1, 2], [0, 2, 1]])
    with pytest.raises(ValueError, match=r"Nodes \[3, 4\] belong to no cell"):
        block_pattern(cells, 5)
    for bad, n in ((cells, 2), (cells - 1, 3), (cells[:0], 3)):
        with pytest.raises(ValueError, match="`cells` must hold node numbers in"):
            block_pattern(bad, n)

"""The tangential group in nodal frames against the exact solve of its four fields."""

import numpy as np
import pytest

from jaxwillmore.linalg import SparseSolver, TangentGroup
from jaxwillmore.linalg._direct import ColumnStructure, SuperLU
from jaxwillmore.linalg._flexible import flexible_gmres
from jaxwillmore.linalg._groups import block_matrix
from jaxwillmore.linalg._krylov import GaussSeidel
from jaxwillmore.mesh import icosphere

from .systems import sphere_pattern
from .test_direct import host_pattern

W, KAPPA = (1, 2, 3), 4
GROUPS = {
    "exact": (((0,),), ((*W, KAPPA),)),
    1: (((0,),), TangentGroup(W, KAPPA, 1)),
    2: (((0,),), TangentGroup(W, KAPPA)),
}


def surface_blocks(level: int, coupling: float = 0.0):
    r"""Linear elements on a sphere, with a fifth field $u$ in front.

    $(\nabla w, \nabla\eta) + (\kappa\nu, \eta)$, $(w\cdot\nu, \xi)$ and $(\nabla u, \nabla\chi) +
    (u, \chi)$; `coupling` times the mass matrix between $u$ and the others, both ways.
    """
    mesh, x = icosphere(level, 1)
    cells, x = np.asarray(mesh.cells), np.asarray(x)
    pattern = sphere_pattern(level, 1)
    corners = x[cells]
    edges = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)  # opposite to each corner
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    stiffness = np.einsum("cik,cjk->cij", edges, edges) / (4 * area)[:, None, None]
    # Integrals of products of three basis functions over a triangle of area one.
    i, j, k = np.indices((3, 3, 3))
    equal = (i == j).astype(int) + (j == k) + (k == i)
    triple = np.array([1, 2, 0, 6])[equal] / 60
    mass = triple.sum(2) * area[:, None, None]
    by_normal = np.einsum("ijk,ckn->cijn", triple, corners) * area[:, None, None, None]
    local = np.zeros((*stiffness.shape, 5, 5))
    local[..., 0, 0] = stiffness + mass
    local[..., W, W] = stiffness[..., None]
    local[..., W, KAPPA] = by_normal
    local[..., KAPPA, W] = by_normal
    local[..., 0, 1:] = local[..., 1:, 0] = coupling * mass[..., None]
    data = np.zeros((pattern.n_blocks, 5, 5))
    np.add.at(data, np.asarray(pattern.blocks), local)
    return host_pattern(pattern), data


def preconditioner(pattern, data, groups) -> GaussSeidel:
    return GaussSeidel(
        pattern, data, groups, lambda fields: ColumnStructure(pattern, fields), SuperLU
    )


def columns_of(apply, size: int) -> np.ndarray:
    return np.stack([apply(e) for e in np.eye(size)], axis=1)


@pytest.mark.parametrize("steps", [1, 2])
def test_the_transpose_is_the_transpose(steps):
    pattern, data = surface_blocks(1, 0.3)
    apply = preconditioner(pattern, data, GROUPS[steps]).apply
    size = data.shape[1] * pattern.n_nodes
    forward = columns_of(lambda v: apply(v, False), size)
    backward = columns_of(lambda v: apply(v, True), size)
    np.testing.assert_allclose(backward, forward.T, atol=1e-12 * np.max(abs(forward)))


def defect(level: int, steps: int) -> float:
    """The spectral radius of what a solve in frames leaves: I - PA."""
    pattern, data = surface_blocks(level)
    apply = preconditioner(pattern, data, GROUPS[steps]).apply
    A = block_matrix(pattern, data)
    left = columns_of(lambda v: v - apply(A @ v, False), A.shape[0])
    return float(np.max(np.abs(np.linalg.eigvals(left))))


def test_what_frames_leave_out_is_of_the_size_of_the_angle_between_normals():
    """It shrinks with the mesh, and a second step squares it."""
    coarse, fine = defect(0, 1), defect(1, 1)
    assert fine < 0.7 * coarse < 0.7
    assert defect(1, 2) == pytest.approx(fine**2, rel=1e-6)


@pytest.mark.parametrize("transpose", [False, True])
def test_two_steps_need_as_many_iterations_as_the_exact_solve(transpose):
    pattern, data = surface_blocks(2, 0.5)
    A = block_matrix(pattern, data)
    A = A.T if transpose else A
    b = np.random.default_rng(0).normal(size=A.shape[0])
    counts = {}
    for name, groups in GROUPS.items():
        sweep = preconditioner(pattern, data, groups)
        found = flexible_gmres(A.__matmul__, lambda v, s=sweep: s.apply(v, transpose), b, 1e-10)
        assert found.converged
        counts[name] = found.iterations
    assert abs(counts[2] - counts["exact"]) <= 1, counts
    assert counts[1] <= counts["exact"] + 6, counts


def test_factors_are_a_fraction_of_those_of_four_fields():
    pattern, data = surface_blocks(3)
    four = SuperLU(ColumnStructure(pattern, 4), data[:, 1:, 1:])
    group = preconditioner(pattern, data, GROUPS[2])._groups[1]
    frames = sum(lu.nbytes for lu in (group._tangential, group._tangency, group._multiplier))
    assert frames < 0.4 * four.nbytes


def test_a_node_without_a_normal_is_singular():
    pattern, data = surface_blocks(0)
    data[(pattern.rows == 3) & (pattern.cols == 3), KAPPA] = 0.0
    with pytest.raises(RuntimeError, match="no normal"):
        preconditioner(pattern, data, GROUPS[2])


def test_a_group_is_hashable_and_its_arguments_are_checked():
    assert hash(SparseSolver(GROUPS[2])) == hash(SparseSolver((((0,),), TangentGroup(W, KAPPA))))
    with pytest.raises(ValueError, match="`steps` must be 1 or more"):
        TangentGroup(W, KAPPA, 0)
    with pytest.raises(ValueError, match="three columns"):
        TangentGroup((1, 2), KAPPA)

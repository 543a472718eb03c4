"""Reference surfaces: normals, matrices, and the next reference from a displacement."""

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float

from ..fem import Rule, load, mass_and_stiffness, rule_for
from ..linalg import (
    BlockPattern,
    HostMatrix,
    SparseOperator,
    SparseSolver,
    block_pattern,
    scatter_blocks,
)
from ..mesh import SurfaceMesh
from ..surface import recover_normal
from ._frozen import Reference

# Degrees of exactness at which the energy is as good as with any higher one (P1, P2, P3, P4).
QUADRATURE_DEGREES = {1: 4, 2: 6, 3: 8, 4: 10}


def prepare(mesh: SurfaceMesh) -> tuple[Rule, BlockPattern]:
    """Quadrature and sparsity of a mesh: what all its reference surfaces share."""
    return rule_for(mesh, QUADRATURE_DEGREES[mesh.degree]), block_pattern(mesh.cells, mesh.n_nodes)


@eqx.filter_jit
def reference(
    mesh: SurfaceMesh,
    rule: Rule,
    pattern: BlockPattern,
    X: Float[Array, "nodes 3"],
    c: Float[Array, " nodes"] | None = None,
) -> Reference:
    r"""The reference surface with nodes `X`, and the concentration `c` on it if there is one.

    Its normals are the normalised L² projection of the element normals; its rigid rows are the
    normal parts of three translations and three rotations about the mean node, tested. A node that
    moves along its normal only stays behind a motion t by its tangential part: there c changes by
    $-\nabla c\cdot t$.
    """
    mass, stiffness = _matrices(mesh, rule, pattern, X)
    n = recover_normal(mesh, X)
    arm = X - jnp.mean(X, axis=0, keepdims=True)
    motions = jnp.concatenate([n, jnp.cross(arm, n)], axis=1)
    rigid = jnp.zeros_like(motions).at[pattern.rows].add(mass[:, None] * motions[pattern.cols])
    of_c = None if c is None else _left_behind(mesh, X, arm, c).T
    return Reference(mesh, rule, pattern, X, n, mass, stiffness, rigid.T, c, of_c)


def _left_behind(mesh, X, arm, c) -> Float[Array, "nodes 6"]:
    """What six rigid motions change of a concentration that does not move, tested."""

    def tested(_, f, phi, __):
        return -phi * jnp.concatenate([f.c.grad, jnp.cross(f.arm.value, f.c.grad)])

    return load(mesh, X, tested, {"c": c, "arm": arm})


def _matrices(mesh, rule, pattern, X):
    """Mass and stiffness entries on the pattern."""
    local = mass_and_stiffness(mesh, rule, X)
    return (scatter_blocks(pattern, matrices[..., None, None])[:, 0, 0] for matrices in local)


def advanced(r: Reference, s: Float[Array, " nodes"]) -> Float[Array, "nodes 3"]:
    r"""Nodes of the next reference surface: $X + w$ with the least deformation.

    $$ w = \arg\min \tfrac12 \int |\nabla_\Gamma w|^2 \quad\text{with}\quad w_i\cdot n_i = s_i $$

    Nodes that only ever moved along normals would crowd and spread; w spreads the strain.

    ??? cite "Reference"
        Hu, Li (2022), *Numer. Math.* 152, 127–181 (as a velocity; here as a displacement).
    """
    blocks, rhs = _tangential_equations(r, s)
    matrix = HostMatrix(r.pattern, np.asarray(blocks))
    tangential = jnp.asarray(matrix.solve(np.asarray(rhs), 1e-10)[0])
    matrix.release()
    return _displaced(r, s, tangential)


@eqx.filter_jit
def _tangential_equations(r: Reference, s):
    T = _tangents(r.n)
    rows, cols = r.pattern.rows, r.pattern.cols
    blocks = r.stiffness[:, None, None] * jnp.einsum("bia,bic->bac", T[rows], T[cols])
    normal = s[:, None] * r.n
    pull = jnp.zeros_like(normal).at[rows].add(r.stiffness[:, None] * normal[cols])
    return blocks, -jnp.einsum("nia,ni->na", T, pull).reshape(-1)


@eqx.filter_jit
def _displaced(r: Reference, s, tangential):
    w = jnp.einsum("nia,na->ni", _tangents(r.n), tangential.reshape(-1, 2))
    return r.X + s[:, None] * r.n + w


def _tangents(n: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3 2"]:
    """Two orthonormal tangents at every node."""
    axis = jnp.eye(3)[jnp.argmin(jnp.abs(n), axis=1)]
    first = jnp.cross(n, axis)
    first = first / jnp.linalg.norm(first, axis=1, keepdims=True)
    return jnp.stack([first, jnp.cross(n, first)], axis=-1)


@eqx.filter_jit
def _without_facets(r: Reference, strength):
    blocks = (r.mass + strength * r.stiffness)[:, None, None] * jnp.ones((1, 1, 1))
    operator = SparseOperator(blocks, r.pattern)
    rhs = jnp.zeros_like(r.X).at[r.pattern.rows].add(r.mass[:, None] * r.X[r.pattern.cols])

    def solve(column):
        return lx.linear_solve(operator, column, SparseSolver(rtol=1e-10), throw=False).value

    return jnp.stack([solve(rhs[:, k]) for k in range(3)], axis=1)


def without_facets(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
    r"""One implicit smoothing $(M + 0.3 h^2 S)^{-1} M x$, with h the mean size of a triangle.

    For faceted input that was raised to degree 2: it takes off the facets and leaves the shape.
    Noise and voxels are a matter for `surface.smoothed`.
    """
    r = reference(mesh, *prepare(mesh), x)
    h2 = float(jnp.sum(r.mass)) * 4 / np.sqrt(3) / mesh.n_cells
    return _without_facets(r, jnp.asarray(0.3 * h2))

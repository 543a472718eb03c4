"""Small sparse systems on a sphere mesh, and their dense twins."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float

from jaxwillmore.linalg import (
    AbstractSparseSystem,
    BlockPattern,
    Border,
    SparseOperator,
    block_pattern,
)
from jaxwillmore.mesh import icosphere


def sphere_pattern(level=0, degree=1) -> BlockPattern:
    mesh, _ = icosphere(level, degree)
    return block_pattern(mesh.cells, mesh.n_nodes)


def diagonal_blocks(pattern) -> np.ndarray:
    """The position of the diagonal block of every node."""
    return np.flatnonzero(np.asarray(pattern.rows) == np.asarray(pattern.cols))


def random_blocks(key, pattern, fields, diagonal=4.0) -> Float[Array, "blocks fields fields"]:
    """Nonsymmetric blocks; with a large diagonal the matrix is well conditioned."""
    data = jr.normal(key, (pattern.n_blocks, fields, fields)) / 4
    return data.at[diagonal_blocks(pattern)].add(diagonal * jnp.eye(fields)[None])


def random_border(key, pattern, fields, n_globals) -> Border:
    keys = jr.split(key, 3)
    shape = (n_globals, pattern.n_nodes, fields)
    return Border(
        jr.normal(keys[0], shape),
        jr.normal(keys[1], shape),
        jr.normal(keys[2], (n_globals, n_globals)),
    )


def dense(operator: SparseOperator) -> np.ndarray:
    """The whole matrix, assembled entry by entry."""
    pattern, data = operator.pattern, np.asarray(operator.data)
    n, fields = pattern.n_nodes, data.shape[-1]
    A = np.zeros((n, n, fields, fields))
    A[np.asarray(pattern.rows), np.asarray(pattern.cols)] = data
    A = A.transpose(0, 2, 1, 3).reshape(n * fields, n * fields)
    border = operator.border
    m = operator.n_globals
    B = np.asarray(border.columns).reshape(m, n * fields).T
    C = np.asarray(border.rows).reshape(m, n * fields)
    full = np.block([[A, B], [C, np.asarray(border.corner)]])
    return full.T if operator.transposed else full


class Sinh(AbstractSparseSystem):
    """A y + p sinh(y) = b: monotone for a positive A and p, so that it has one root."""

    operator: SparseOperator
    p: Float[Array, ""]
    b: Float[Array, " unknowns"]

    @property
    def pattern(self):
        return self.operator.pattern

    @property
    def n_globals(self):
        return self.operator.n_globals

    def residual(self, y):
        return self.operator.mv(y) + self.p * jnp.sinh(y) - self.b

    def jacobian(self, y):
        op, fields = self.operator, self.operator.data.shape[-1]
        slope = self.p * jnp.cosh(y)
        nodal = jax.vmap(jnp.diag)(slope[: slope.shape[0] - self.n_globals].reshape(-1, fields))
        data = op.data.at[diagonal_blocks(jax.tree.map(np.asarray, PATTERN))].add(nodal)
        corner = op.border.corner + jnp.diag(slope[slope.shape[0] - self.n_globals :])
        return SparseOperator(
            data, op.pattern, eqx.tree_at(lambda border: border.corner, op.border, corner)
        )


PATTERN = sphere_pattern()
FIELDS = 2


def sinh_system(n_globals=0, p=0.5) -> Sinh:
    keys = jr.split(jr.key(0), 3)
    border = jax.tree.map(lambda a: 0.1 * a, random_border(keys[1], PATTERN, FIELDS, n_globals))
    border = eqx.tree_at(
        lambda border: border.corner, border, border.corner + 3 * jnp.eye(n_globals)
    )
    operator = SparseOperator(random_blocks(keys[0], PATTERN, FIELDS), PATTERN, border)
    b = jr.normal(keys[2], operator.in_structure().shape)
    return Sinh(operator, jnp.asarray(p), b)

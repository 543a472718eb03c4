"""SparseOperator: an assembled block-sparse matrix as a Lineax linear operator."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from ._pattern import BlockPattern


class Border(eqx.Module):
    """Dense rows and columns for a few global unknowns beside the nodal ones.

    **Attributes:**

    - `columns[k]`: derivative of the nodal equations by global unknown `k`.
    - `rows[k]`: derivative of global equation `k` by the nodal unknowns.
    - `corner`: derivative of the global equations by the global unknowns.
    """

    columns: Float[Array, "globals nodes fields"]
    rows: Float[Array, "globals nodes fields"]
    corner: Float[Array, "globals globals"]


def no_border(n_nodes: int, n_fields: int) -> Border:
    """The border of a system without global unknowns."""
    empty = jnp.zeros((0, n_nodes, n_fields))
    return Border(empty, empty, jnp.zeros((0, 0)))


class SparseOperator(lx.AbstractLinearOperator):
    r"""A square matrix of dense blocks on a `BlockPattern`, with a border for global unknowns.

    It acts on flat vectors: first the nodal unknowns, node by node, then the global ones,

    $$ \begin{pmatrix} A & B \\ C & D \end{pmatrix} $$

    with $A$ block-sparse and $B$, $C$, $D$ the border.

    **Arguments:**

    - `data`: the blocks, in the order of the pattern; `data[k, f, g]` couples equation `f` at node
      `rows[k]` to unknown `g` at node `cols[k]`.
    - `pattern`: where the blocks sit.
    - `border`: rows and columns of the global unknowns, if there are any.
    - `transposed`: act as the transpose. No data moves.
    """

    data: Float[Array, "blocks fields fields"]
    pattern: BlockPattern
    border: Border
    transposed: bool = eqx.field(static=True)

    def __init__(self, data, pattern: BlockPattern, border: Border | None = None, transposed=False):
        if border is None:
            border = no_border(pattern.n_nodes, data.shape[-1])
        self.data, self.pattern, self.border, self.transposed = data, pattern, border, transposed

    @property
    def n_globals(self) -> int:
        """Number of global unknowns."""
        return self.border.corner.shape[0]

    def mv(self, vector: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        fields = self.data.shape[-1]
        n_nodal = self.pattern.n_nodes * fields
        nodal, tail = vector[:n_nodal].reshape(-1, fields), vector[n_nodal:]
        source, target = self.pattern.cols, self.pattern.rows
        spec, B, C, D = "bfg,bg->bf", self.border.columns, self.border.rows, self.border.corner
        if self.transposed:
            source, target, spec, B, C, D = target, source, "bfg,bf->bg", C, B, D.T
        out = jnp.zeros_like(nodal).at[target].add(jnp.einsum(spec, self.data, nodal[source]))
        out = out + jnp.tensordot(tail, B, axes=1)
        return jnp.concatenate([out.reshape(-1), jnp.tensordot(C, nodal, axes=2) + D @ tail])

    def as_matrix(self) -> Float[Array, "unknowns unknowns"]:
        """All entries, zeros included: for small systems, and to test with."""
        p, (n, f) = self.pattern, (self.pattern.n_nodes, self.data.shape[-1])
        blocks = jnp.zeros((n, n, f, f), self.data.dtype).at[p.rows, p.cols].set(self.data)
        nodal = blocks.transpose(0, 2, 1, 3).reshape(n * f, n * f)
        B = self.border.columns.reshape(-1, n * f).T
        C = self.border.rows.reshape(-1, n * f)
        matrix = jnp.block([[nodal, B], [C, self.border.corner]])
        return matrix.T if self.transposed else matrix

    def transpose(self):
        return SparseOperator(self.data, self.pattern, self.border, not self.transposed)

    def in_structure(self):
        size = self.pattern.n_nodes * self.data.shape[-1] + self.n_globals
        return jax.ShapeDtypeStruct((size,), self.data.dtype)

    def out_structure(self):
        return self.in_structure()


def _no(operator):
    del operator
    return False


for _property in (
    lx.is_symmetric,
    lx.is_diagonal,
    lx.is_tridiagonal,
    lx.has_unit_diagonal,
    lx.is_lower_triangular,
    lx.is_upper_triangular,
    lx.is_positive_semidefinite,
    lx.is_negative_semidefinite,
):
    _property.register(SparseOperator)(_no)


@lx.linearise.register(SparseOperator)
@lx.materialise.register(SparseOperator)
@lx.conj.register(SparseOperator)
def _itself(operator):
    return operator

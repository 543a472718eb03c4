"""SparseOperator: an assembled block-sparse matrix as a Lineax linear operator."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from ._pattern import BlockPattern


class SparseOperator(lx.AbstractLinearOperator):
    """A square matrix of dense blocks on a `BlockPattern`, acting on nodal arrays.

    **Arguments:**

    - `data`: the blocks, in the order of the pattern; `data[k, f, g]` couples equation `f` at node
      `rows[k]` to unknown `g` at node `cols[k]`.
    - `pattern`: where the blocks sit.
    - `transposed`: act as the transpose. No data moves.
    """

    data: Float[Array, "blocks fields fields"]
    pattern: BlockPattern
    transposed: bool = eqx.field(static=True, default=False)

    def mv(self, vector: Float[Array, "nodes fields"]) -> Float[Array, "nodes fields"]:
        source, target = self.pattern.cols, self.pattern.rows
        spec = "bfg,bg->bf"
        if self.transposed:
            source, target, spec = target, source, "bfg,bf->bg"
        products = jnp.einsum(spec, self.data, vector[source])
        return jnp.zeros_like(vector).at[target].add(products)

    def as_matrix(self):
        raise ValueError("A SparseOperator is never made dense; solve with `linalg.SparseSolver`.")

    def transpose(self):
        return SparseOperator(self.data, self.pattern, not self.transposed)

    def in_structure(self):
        return jax.ShapeDtypeStruct((self.pattern.n_nodes, self.data.shape[-1]), self.data.dtype)

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

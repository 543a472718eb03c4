"""Dense LU inside compiled functions: for small systems, under `vmap`, on any device."""

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
from jax.scipy.linalg import lu_factor, lu_solve
from jaxtyping import Array, Float, Int

from ._factorised import LARGEST_RESIDUAL
from ._methods import checked_method
from ._operator import SparseOperator


class DenseFactors(eqx.Module):
    """A matrix with its LU factors."""

    lu: Float[Array, "unknowns unknowns"]
    pivots: Int[Array, " unknowns"]
    operator: SparseOperator

    @classmethod
    def unprepared(cls, operator: SparseOperator) -> "DenseFactors":
        """The same arrays with nothing in them."""
        n = operator.in_size()
        return cls(jnp.zeros((n, n)), jnp.zeros(n, jnp.int32), operator)

    def transpose(self) -> "DenseFactors":
        """The same factors for the transposed system."""
        return DenseFactors(self.lu, self.pivots, self.operator.transpose())

    def solve(self, vector: Float[Array, " unknowns"], rtol: float):
        """Solution, steps of refinement (one) and outcome."""
        transposed = self.operator.transposed

        def inverse(b):
            return lu_solve((self.lu, self.pivots), b, trans=int(transposed))

        x = inverse(vector)
        x = x + inverse(vector - self.operator.mv(x))
        missing = jnp.linalg.norm(vector - self.operator.mv(x))
        finite = jnp.all(jnp.isfinite(vector)) & jnp.all(jnp.isfinite(self.operator.data))
        # A singular matrix has an infinite solution, or one that solves nothing.
        solved = missing <= max(rtol, LARGEST_RESIDUAL) * jnp.linalg.norm(vector)
        result = lx.RESULTS.where(solved, lx.RESULTS.successful, lx.RESULTS.singular)
        result = lx.RESULTS.where(finite, result, lx.RESULTS.nonfinite_input)
        return x, result, {"iterations": jnp.asarray(1, jnp.int32)}


def dense_factors(operator: SparseOperator) -> DenseFactors:
    """The factors of a small matrix.

    **Raises:** `ValueError` for too many unknowns.
    """
    checked_method("dense", operator.in_size())
    forward = operator.transpose() if operator.transposed else operator
    lu, pivots = lu_factor(forward.as_matrix())
    return DenseFactors(lu, pivots, operator)

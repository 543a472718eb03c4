"""Nonlinear systems that know their sparse Jacobian."""

import abc

import equinox as eqx
from jaxtyping import Array, Float

from ._operator import SparseOperator
from ._pattern import BlockPattern


class AbstractSparseSystem(eqx.Module):
    """Equations F(y) = 0 for a flat vector y, with an assembled Jacobian.

    The vector holds the nodal unknowns, node by node, then `n_globals` global ones.

    A system is passed as `args` to `optimistix.root_find`, so that its arrays stay inputs of the
    solve and derivatives with respect to them follow from the implicit function theorem.
    """

    @property
    @abc.abstractmethod
    def pattern(self) -> BlockPattern:
        """Sparsity of the Jacobian."""

    @property
    @abc.abstractmethod
    def n_globals(self) -> int:
        """Number of global unknowns at the end of the vector."""

    @abc.abstractmethod
    def residual(self, y: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
        """F(y), rows scaled to comparable size."""

    @abc.abstractmethod
    def jacobian(self, y: Float[Array, " unknowns"]) -> SparseOperator:
        """The derivative of `residual` at y."""

"""Nonlinear systems that know their sparse Jacobian."""

import abc

import equinox as eqx
from jaxtyping import Array, Float

from ._operator import SparseOperator
from ._pattern import BlockPattern


class AbstractSparseSystem(eqx.Module):
    """Equations F(y) = 0 for a nodal array y, with an assembled Jacobian.

    A system is passed as `args` to `optimistix.root_find`, so that its arrays stay inputs of the
    solve and derivatives with respect to them follow from the implicit function theorem.
    """

    @property
    @abc.abstractmethod
    def pattern(self) -> BlockPattern:
        """Sparsity of the Jacobian."""

    @abc.abstractmethod
    def residual(self, y: Float[Array, "nodes fields"]) -> Float[Array, "nodes fields"]:
        """F(y), rows scaled to comparable size."""

    @abc.abstractmethod
    def jacobian(self, y: Float[Array, "nodes fields"]) -> SparseOperator:
        """The derivative of `residual` at y."""

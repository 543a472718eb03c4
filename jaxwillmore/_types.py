"""Names for the array shapes that appear in signatures all over the package."""

from typing import TypeAlias

from jaxtyping import Array, Float, Int

Nodes: TypeAlias = Float[Array, "nodes 3"]
"""Positions of the nodes, or any other vector field on them."""

Scalar: TypeAlias = Float[Array, ""]
"""One real number as an array."""

Cells: TypeAlias = Int[Array, "cells local"]
"""Node numbers of every cell, in the local order of `jaxwillmore.reference.lagrange_nodes`."""

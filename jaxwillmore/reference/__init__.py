"""The reference triangle: shape functions, their nodes, and quadrature."""

from ._lagrange import (
    lagrange_basis as lagrange_basis,
    lagrange_gradients as lagrange_gradients,
    lagrange_nodes as lagrange_nodes,
    n_local_nodes as n_local_nodes,
)
from ._quadrature import (
    Quadrature as Quadrature,
    quadrature as quadrature,
    subdivided as subdivided,
)

r"""Lagrange shape functions of degree 1 to 4 on the reference triangle.

The triangle has the vertices (0, 0), (1, 0), (0, 1) and the barycentric coordinates
$\lambda = (1 - \xi_1 - \xi_2, \xi_1, \xi_2)$. Everything here is NumPy: these numbers are
constants of a simulation, evaluated once.
"""

import functools as ft

import numpy as np
from jaxtyping import Float, Int

DEGREES = (1, 2, 3, 4)

# The constant derivatives of the barycentric coordinates with respect to xi.
_BARYCENTRIC_GRADIENTS = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])


def n_local_nodes(degree: int) -> int:
    """Number of nodes of one triangle: 3, 6, 10, 15 for degree 1, 2, 3, 4."""
    if isinstance(degree, bool) or degree not in DEGREES:
        raise ValueError(f"`degree` must be 1, 2, 3 or 4; got {degree!r}.")
    return (degree + 1) * (degree + 2) // 2


@ft.cache
def _multi_indices(degree: int) -> Int[np.ndarray, "local 3"]:
    """Integers m with m/degree the barycentric coordinates of each node, in the local order."""
    n_local_nodes(degree)
    k = degree
    corners = [(k, 0, 0), (0, k, 0), (0, 0, k)]
    edge_01 = [(k - i, i, 0) for i in range(1, k)]
    edge_12 = [(0, k - i, i) for i in range(1, k)]
    edge_20 = [(i, 0, k - i) for i in range(1, k)]
    interior = [(k - i - j, i, j) for j in range(1, k) for i in range(1, k - j)]
    indices = np.array(corners + edge_01 + edge_12 + edge_20 + interior)
    indices.flags.writeable = False
    return indices


def lagrange_nodes(degree: int) -> Float[np.ndarray, "local 2"]:
    """The equispaced nodes of the reference triangle, in the local order used everywhere.

    First the vertices 0, 1, 2; then the nodes inside the edges 0→1, 1→2, 2→0, each edge run
    through from its first to its second vertex; then the interior nodes, ordered like the nodes
    of a smaller triangle.

    **Raises:** `ValueError` unless `degree` is 1, 2, 3 or 4.
    """
    return _multi_indices(degree)[:, 1:] / degree


def _factors(degree: int, barycentric: Float[np.ndarray, "... 3"]):
    r"""$P_m(\lambda) = \prod_{s<m} (k\lambda - s)/(s + 1)$ and $P_m'$, for m = 0, ..., k."""
    values = [np.ones_like(barycentric)]
    slopes = [np.zeros_like(barycentric)]
    for s in range(degree):
        factor = (degree * barycentric - s) / (s + 1)
        slopes.append(slopes[-1] * factor + values[-1] * (degree / (s + 1)))
        values.append(values[-1] * factor)
    return np.stack(values), np.stack(slopes)


def _barycentric(xi: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 3"]:
    return np.concatenate([1.0 - xi.sum(axis=-1, keepdims=True), xi], axis=-1)


def lagrange_basis(degree: int, xi: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... local"]:
    r"""Values of the shape functions at `xi`.

    $$ \varphi_m(\lambda) = P_{m_0}(\lambda_0) P_{m_1}(\lambda_1) P_{m_2}(\lambda_2), \qquad
       P_m(\lambda) = \prod_{s=0}^{m-1} \frac{k\lambda - s}{s + 1} $$

    with one multi-index $|m| = k$ per node $\lambda = m/k$: $\varphi_i(\xi_j) = \delta_{ij}$.

    **Raises:** `ValueError` unless `degree` is 1, 2, 3 or 4.

    ??? cite "Reference"
        Silvester (1969), *Int. J. Eng. Sci.* 7, 849–861.
    """
    indices = _multi_indices(degree)
    values, _ = _factors(degree, _barycentric(np.asarray(xi, dtype=np.float64)))
    first, second, third = (values[indices[:, i], ..., i] for i in range(3))
    return np.moveaxis(first * second * third, 0, -1)


def lagrange_gradients(
    degree: int, xi: Float[np.ndarray, "... 2"]
) -> Float[np.ndarray, "... local 2"]:
    """Derivatives of the shape functions with respect to `xi`; see `lagrange_basis`.

    **Raises:** `ValueError` unless `degree` is 1, 2, 3 or 4.
    """
    indices = _multi_indices(degree)
    values, slopes = _factors(degree, _barycentric(np.asarray(xi, dtype=np.float64)))
    value = [values[indices[:, i], ..., i] for i in range(3)]
    slope = [slopes[indices[:, i], ..., i] for i in range(3)]
    by_barycentric = np.stack(
        [
            slope[0] * value[1] * value[2],
            value[0] * slope[1] * value[2],
            value[0] * value[1] * slope[2],
        ],
        axis=-1,
    )
    return np.moveaxis(by_barycentric @ _BARYCENTRIC_GRADIENTS, 0, -2)

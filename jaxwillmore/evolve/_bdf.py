r"""Backward differentiation on any sequence of times.

All coefficients come from one interpolation: the polynomial through the values at
$t_{n+1}, t_n, \dots, t_{n+1-q}$, differentiated or evaluated at $t_{n+1}$. On equal steps they are
the coefficients of $\delta(\zeta) = \sum_{l\le q}(1-\zeta)^l/l$ and
$\gamma(\zeta) = (1-(1-\zeta)^q)/\zeta$.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def extrapolation(times: Float[Array, " points"], t: Float[Array, ""]) -> Float[Array, " points"]:
    r"""Weights $\gamma_j$ that take values at `times` (newest first) to time `t`."""
    n = times.shape[0]
    off = ~np.eye(n, dtype=bool)
    difference = jnp.where(off, times[:, None] - times[None, :], 1.0)
    factor = jnp.where(off, (t - times)[None, :] / difference, 1.0)
    return jnp.prod(factor, axis=1)


def bdf(times: Float[Array, " points"], t: Float[Array, ""]) -> Float[Array, " points_plus_1"]:
    r"""Weights of the derivative at `t`: first of the value at `t`, then of those at `times`.

    Row $l$ of the sum is the Newton form: with distances $d_j = t - t_j$, the derivative of the
    interpolant is $\sum_j c_j (u(t) - u_j)$ with
    $c_j = \prod_{i\ne j} d_i / (d_j \prod_{i\ne j}(d_i - d_j))$. Units 1/time.
    """
    d = t - times
    n = d.shape[0]
    off = ~np.eye(n, dtype=bool)
    gap = jnp.where(off, d[None, :] - d[:, None], 1.0)
    factor = jnp.where(off, d[None, :] / gap, 1.0)
    c = jnp.prod(factor, axis=1) / d
    return jnp.concatenate([jnp.sum(c)[None], -c])


def padded(weights: Float[Array, " n"], length: int) -> Float[Array, " length"]:
    """Weights of an order below the highest, with zeros for the values it does not use."""
    return jnp.concatenate([weights, jnp.zeros(length - weights.shape[0])])

"""A field at one quadrature point: its value and its tangential gradient."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Jet(eqx.Module):
    r"""Value and tangential gradient of a scalar or vector field at one point.

    `grad` is component first: for a vector field `grad[i, j]` is the j-th Cartesian component of
    $\nabla_\Gamma u_i$, so that the rows of `grad` are tangential gradients.
    """

    value: Float[Array, "..."]
    grad: Float[Array, "... 3"]


def inner(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, ""]:
    """Euclidean (Frobenius) inner product of two arrays of the same shape."""
    return jnp.sum(a * b)


def trace(a: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Trace; `trace(u.grad)` is the tangential divergence of a vector field."""
    return a[0, 0] + a[1, 1] + a[2, 2]


def sym(a: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Symmetric part; `sym(nu.grad)` is the discrete Weingarten map."""
    return 0.5 * (a + a.T)

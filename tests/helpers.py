"""Small tools of numerical analysis shared by the tests."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jaxtyping import Array, Float


def observed_order(hs: Sequence[float], errors: Sequence[float]) -> float:
    """Least-squares slope of log(error) against log(h)."""
    return float(np.polyfit(np.log(np.asarray(hs)), np.log(np.asarray(errors)), 1)[0])


def taylor_remainders(
    f: Callable, x: Float[Array, "..."], direction: Float[Array, "..."], steps: Sequence[float]
) -> list[float]:
    """|f(x + h d) − f(x) − h f'(x)d| for each h; falls as h² when f' is right."""
    value, slope = jax.jvp(f, (x,), (direction,))
    return [float(jnp.abs(f(x + h * direction) - value - h * slope)) for h in steps]


def random_rotation(key: Array) -> Float[Array, "3 3"]:
    """A rotation (determinant +1) drawn uniformly: QR of a normal matrix with signs fixed."""
    Q, R = jnp.linalg.qr(jr.normal(key, (3, 3)))
    Q = Q * jnp.sign(jnp.diagonal(R))[None, :]
    return Q.at[:, 0].multiply(jnp.sign(jnp.linalg.det(Q)))


# Of tests that hand in a NaN themselves, which JAX then finds before anybody else does.
with_nan = pytest.mark.skipif(jax.config.jax_debug_nans, reason="JAX looks for NaNs")

"""Parameters as arrays, refused where they make no sense."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def finite(name: str, value) -> Float[Array, ""]:
    """A real number as an array; tracers pass unchecked.

    **Raises:** `ValueError` unless it is one finite real number.
    """
    if isinstance(value, jax.core.Tracer):
        return value
    array = np.asarray(value)
    if array.shape != () or array.dtype.kind not in "iuf" or not np.isfinite(array):
        raise ValueError(f"`{name}` must be one finite number; got {value!r}.")
    return jnp.asarray(array, float)


def non_negative(name: str, value) -> Float[Array, ""]:
    """As `finite`, and not negative."""
    array = finite(name, value)
    if not isinstance(array, jax.core.Tracer) and array < 0:
        raise ValueError(f"`{name}` must not be negative; got {value!r}.")
    return array


def positive(name: str, value) -> Float[Array, ""]:
    """As `finite`, and positive."""
    array = finite(name, value)
    if not isinstance(array, jax.core.Tracer) and array <= 0:
        raise ValueError(f"`{name}` must be positive; got {value!r}.")
    return array

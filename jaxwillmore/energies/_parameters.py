"""Parameters as arrays, refused where they make no sense."""

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh


def finite(name: str, value) -> Float[Array, ""]:
    """A real number as an array; tracers pass unchecked.

    **Raises:** `ValueError` unless it is one finite real number.
    """
    if isinstance(value, Tracer):
        return value
    array = np.asarray(value)
    if array.shape != () or array.dtype.kind not in "iuf" or not np.isfinite(array):
        raise ValueError(f"`{name}` must be one finite number; got {value!r}.")
    return jnp.asarray(array, float)


def non_negative(name: str, value) -> Float[Array, ""]:
    """As `finite`, and not negative."""
    array = finite(name, value)
    if not isinstance(array, Tracer) and array < 0:
        raise ValueError(f"`{name}` must not be negative; got {value!r}.")
    return array


def positive(name: str, value) -> Float[Array, ""]:
    """As `finite`, and positive."""
    array = finite(name, value)
    if not isinstance(array, Tracer) and array <= 0:
        raise ValueError(f"`{name}` must be positive; got {value!r}.")
    return array


def finite_field(name: str, value) -> Float[Array, "..."]:
    """A real number, or an array with one for every node; tracers pass unchecked.

    **Raises:** `ValueError` unless all numbers are real and finite and stand in one axis at most.
    Whether there is one for every node is seen when a mesh is at hand, by `on_nodes`.
    """
    if isinstance(value, Tracer):
        return value
    array = np.asarray(value)
    if array.ndim == 0:
        return finite(name, value)
    if array.ndim > 1 or array.dtype.kind not in "iuf":
        raise ValueError(
            f"`{name}` must be one finite number, or an array with one for every node; got shape "
            f"{array.shape} of {array.dtype}."
        )
    wrong = np.flatnonzero(~np.isfinite(array))
    if len(wrong):
        raise ValueError(f"`{name}` must be finite; got {array[wrong[0]]} at node {wrong[0]}.")
    return jnp.asarray(array, float)


def positive_field(name: str, value) -> Float[Array, "..."]:
    """As `finite_field`, and positive."""
    array = finite_field(name, value)
    if isinstance(array, Tracer):
        return array
    if array.ndim == 0:
        return positive(name, value)
    wrong = np.flatnonzero(np.asarray(array) <= 0)
    if len(wrong):
        raise ValueError(f"`{name}` must be positive; got {array[wrong[0]]} at node {wrong[0]}.")
    return array


def on_nodes(name: str, value: Float[Array, "..."], mesh: SurfaceMesh) -> Float[Array, " nodes"]:
    """A number or nodal field as one number per node of `mesh`.

    **Raises:** `ValueError` for a field of another length, also inside `jit`.
    """
    if value.ndim and value.shape != (mesh.n_nodes,):
        raise ValueError(
            f"`{name}` must be one number, or one for each of the {mesh.n_nodes} nodes; got shape "
            f"{value.shape}."
        )
    return jnp.broadcast_to(value, (mesh.n_nodes,))

"""Parameters as arrays, refused where they make no sense."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._arguments import double
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


def nodes_of(mesh: SurfaceMesh, x) -> Float[Array, "nodes 3"]:
    """The positions of the nodes in float64.

    **Raises:** `ValueError` for another shape or too few digits; see `double`.
    """
    x = double("x", x)
    if x.shape != (mesh.n_nodes, 3):
        raise ValueError(f"`x` needs shape ({mesh.n_nodes}, 3), a row per node; got {x.shape}.")
    return x


def density_of(
    mesh: SurfaceMesh, fields: Mapping[str, Any] | None, who: str, name: str = "c"
) -> Float[Array, " nodes"]:
    """The nodal concentration of the moment, which the energy `who` depends on.

    **Raises:** `ValueError` if there is none, or not one number for every node.
    """
    if fields is None or name not in fields:
        raise ValueError(
            f'{who} needs a concentration `{name}`: call `energy(mesh, x, {{"{name}": {name}}})` '
            f"with one number for each of the {mesh.n_nodes} nodes."
        )
    c = double(name, fields[name])
    if c.shape != (mesh.n_nodes,):
        raise ValueError(
            f"{who} needs a concentration `{name}` with one number for each of the {mesh.n_nodes} "
            f"nodes; got shape {c.shape}."
        )
    return c


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

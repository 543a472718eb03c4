"""How much of a phase there is."""

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ..surface import area


def amount(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], c: Float[Array | np.ndarray, " nodes"]
) -> Float[Array, ""]:
    r"""$\int c$ with the quadrature of the weak forms: what a conservative step conserves.

    A finer rule would see the same concentration hold another amount after every step.
    """
    c = jnp.asarray(c, float)
    return integrate(mesh, x, lambda _, f: f.c.value, {"c": c}, quadrature_degree=2 * mesh.degree)


def with_mean(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], c: Float[Array | np.ndarray, " nodes"], mean
) -> Float[Array, " nodes"]:
    r"""The same concentration with `amount` over `surface.area` = `mean` to rounding.

    That is what a run holds that holds the area. One number is added to all nodes: interfaces and
    gradients stay what they are.

    **Raises:** `ValueError` unless the mean lies between 0 and 1.
    """
    check_mean(mean)
    c = jnp.asarray(c, float)
    missing = mean * area(mesh, x) - amount(mesh, x, c)
    return c + missing / amount(mesh, x, jnp.ones_like(c))


def check_mean(mean) -> None:
    """**Raises:** `ValueError` unless there is some of both phases; tracers pass."""
    if not isinstance(mean, Tracer) and not 0 < mean < 1:
        raise ValueError(
            f"`mean` must lie between 0 and 1: the amount must fit on the surface; got {mean}."
        )

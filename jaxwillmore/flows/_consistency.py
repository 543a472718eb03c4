r"""The terms that keep $H_h$ and $\nu_h$ on the surface they belong to, and their weight."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet, Point, inner, trace

WEIGHTS = ("global", "local")


def mean_curvature_consistency(H: Jet, nu: Jet, alpha: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$(H, \alpha\chi) - (1, \nabla\cdot(\alpha\chi\nu))$: $H_h$ against the surface.

    On a closed surface $\int \nabla\cdot(\alpha\chi\nu) = \int H\,\alpha\chi$, whatever $\nu_h$
    does tangentially: the second term is the weak mean curvature of $x$ itself, tested with
    $\alpha\chi$. The weight must be inside the divergence; outside, its gradient would leave the
    tangential error of $\nu_h$ behind.
    """
    weighted = alpha.value * chi.grad + chi.value * alpha.grad
    return alpha.value * chi.value * (H.value - trace(nu.grad)) - inner(nu.value, weighted)


def normal_consistency(nu: Jet, point: Point, alpha: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$(\alpha(\nu - n_\Gamma), \chi)$: $\nu_h$ against the element normal of the surface."""
    return alpha.value * inner(nu.value - point.normal, chi.value)


def consistency_weight(
    weight: str, rate: Float[Array, ""] | Float[Array, " nodes"], curvature: Float[Array, " nodes"]
) -> Float[Array, " nodes"]:
    r"""$\alpha$ at the nodes: `rate` times the curvature power, or its power mean everywhere.

    The fields drift off the surface at rates of the largest curvature (on the Clifford torus with
    $R = 1$ at +172, while $|A|^4$ is 5 on the outside and 185 inside). Weighted locally, the flat
    parts follow too slowly: on tori that open quickly the energy then rises.
    """
    if weight == "local":
        return rate * curvature
    return rate * jnp.full_like(curvature, _smooth_maximum(curvature))


def _smooth_maximum(a: Float[Array, " nodes"]) -> Float[Array, ""]:
    """The mean of order 16: close to the maximum, and differentiable where several values tie.

    Symmetric surfaces have many nodes of largest curvature, where the maximum has no derivative.
    """
    largest = jax.lax.stop_gradient(jnp.max(a))
    safe = jnp.where(largest > 0, largest, 1.0)
    return safe * jnp.mean((a / safe) ** 16) ** (1 / 16)


def checked_weight(weight: str) -> str:
    """`weight`, or a `ValueError` that lists the choices."""
    if weight not in WEIGHTS:
        raise ValueError(f"`consistency_weight` must be one of {WEIGHTS}; got {weight!r}.")
    return weight

"""First fundamental form of an isoparametric cell at one quadrature point."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Point(eqx.Module):
    r"""Geometry of the surface at one quadrature point.

    **Attributes:**

    - `position`: the point itself.
    - `normal`: unit normal of the discrete surface, oriented by the cell's vertex order.
    - `dA`: area element, the factor between reference and surface measure.
    - `lift`: $J G^{-1}$, which takes reference derivatives to the tangential gradient.
    """

    position: Float[Array, "3"]
    normal: Float[Array, "3"]
    dA: Float[Array, ""]
    lift: Float[Array, "3 2"]


def point(position: Float[Array, "3"], J: Float[Array, "3 2"]) -> Point:
    r"""Metric quantities from the Jacobian $J = \partial x / \partial\xi$.

    With $G = J^T J$: $\mathrm{d}A = \sqrt{\det G} = |J_1 \times J_2|$,
    $\nabla_\Gamma u = J G^{-1} \nabla_\xi u$ and $\nu = J_1 \times J_2 / \mathrm{d}A$.
    """
    a, b = J[:, 0], J[:, 1]
    cross = jnp.cross(a, b)
    aa, ab, bb = jnp.sum(a * a), jnp.sum(a * b), jnp.sum(b * b)
    det = jnp.sum(cross * cross)
    dA = jnp.sqrt(det)
    lift = jnp.stack([(bb * a - ab * b) / det, (aa * b - ab * a) / det], axis=1)
    return Point(position, cross / dA, dA, lift)

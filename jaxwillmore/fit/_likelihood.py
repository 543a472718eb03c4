"""The likelihood of points on a surface, as a function that may be differentiated or sampled."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..surface import distance_to_cells
from ._shape_residuals import ShapeResiduals


def log_likelihood(
    model: ShapeResiduals,
    parameters: Float[Array, " unknowns"],
    data: tuple[Float[Array, "points 3"], ...],
    noise: Float[Array, ""],
) -> Float[Array, ""]:
    r"""Logarithm of the probability density of observed points, errors being independent.

    $$ \log p = -\sum_j \frac{d_j^2}{2 s^2} - N \log (s \sqrt{2\pi}) $$

    with $d_j$ the distance of point j to the surface of the model: normal errors of standard
    deviation s, along the normal. A pure function, twice differentiable in `parameters`, `data` and
    `noise`, forward and reverse; $-\infty$ where the model has no solution.

    **Arguments:**

    - `model`: `ShapeFit.residuals` of a fit: equilibria on their frozen references.
    - `parameters`: unknowns laid out as `ShapeFit.u`; `model.unknowns` translates.
    - `data`: points for every target.
    - `noise`: s, in the units of the points.

    *Limits:* derivatives jump, at the order of the mesh, where a closest point crosses an edge.
    """
    total = jnp.zeros(())
    for k, points in enumerate(data):
        _, exists, x = model.shape(parameters, k)
        d = distance_to_cells(model.models[k].equilibrium.mesh.cells, x, points)
        own = -jnp.sum(d**2) / (2 * noise**2) - len(points) * jnp.log(noise * jnp.sqrt(2 * jnp.pi))
        total = total + jnp.where(exists, own, -jnp.inf)
    return total

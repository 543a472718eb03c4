"""What a blurred image does to the place of a surface, taken back."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..fem import inner, load
from ..mesh import SurfaceMesh
from ._curvature import nodal_weingarten_squared, weingarten
from ._recover import recover_normal

# Standard deviation of the blur times the largest |A|: beyond, a first order says nothing.
MOST = 0.75


def deblurred(
    mesh: SurfaceMesh,
    x: Float[Array | np.ndarray, "nodes 3"],
    blur: float | Sequence[float] | np.ndarray,
) -> Float[Array, "nodes 3"]:
    r"""Nodes of a surface seen at half of the height of a blurred edge, back where it is.

    Under a Gaussian of covariance Σ the level ½ of a uniform body lies inside of its surface, to
    first order in the curvature by

    $$ \tfrac12\,\mathrm{tr}(A\,S), \qquad
       S = \Sigma - \frac{\Sigma\nu\,(\Sigma\nu)^T}{\nu\cdot\Sigma\nu}; $$

    for $\Sigma = \sigma^2 I$ that is $\tfrac12\sigma^2 H$. S is the covariance of the blur along
    the surface where it has no part across it. The nodes move outward by that.

    **Arguments:**

    - `mesh`, `x`: a smooth surface of degree 2 or more, as from `spherical`.
    - `blur`: standard deviation of the Gaussian in the unit of x, or three in the order
      **(z, y, x)** of the axes of an image. A voxel that averages its own volume adds a twelfth of
      its edge squared to the variance of an axis.

    *Limits:* first order in σ|A|; a Gaussian, which the image of a microscope is about.

    **Raises:** `ValueError` for a mesh of degree 1, a blur that is negative or not finite, and
    where it is no longer small beside the radii of curvature.

    ```python
    mesh, x = jw.surface.spherical(*jw.surface.from_image(labels, voxel_size=0.1))
    x = jw.surface.deblurred(mesh, x, 0.1)  # a Gaussian of one voxel
    ```
    """
    if mesh.degree < 2:
        raise ValueError(
            "`deblurred` needs the curvature of a mesh of degree 2 or more; got degree 1. "
            "`spherical` makes one, `mesh.raise_degree` as well."
        )
    sigma = np.asarray(blur, dtype=np.float64)
    if sigma.shape not in ((), (3,)):
        raise ValueError(f"`blur` is one number, or three in the order (z, y, x); got {blur!r}.")
    if not np.all(np.isfinite(sigma) & (sigma >= 0)):
        raise ValueError(f"`blur` must not be negative; got {blur!r}.")
    variance = jnp.asarray(np.broadcast_to(sigma, 3)[::-1].copy() ** 2)
    moved, bent = _moved(mesh, jnp.asarray(x, jnp.float64), variance)
    part = float(sigma.max() * bent)
    if not part <= MOST:
        raise ValueError(
            f"The blur times the largest curvature |A| is {part:.2g}; from {MOST:g} on its first "
            "order says nothing. Take a sharper recording, or a smaller `max_degree` in "
            "`spherical` where noise makes the curvature."
        )
    return moved


@eqx.filter_jit
def _moved(mesh: SurfaceMesh, x, variance: Float[Array, "3"]):
    """Moved nodes, and the largest |A|."""
    nu = recover_normal(mesh, x)

    def density(_, jets, phi, __):
        n = jets.nu.value
        spread = variance * n
        # Without any blur S vanishes, and so does its denominator.
        across = inner(n, spread)
        safe = jnp.where(across > 0, across, 1.0)
        S = jnp.diag(variance) - jnp.outer(spread, spread) / safe
        return phi**2 * jnp.stack([0.5 * inner(weingarten(jets.nu), S), jnp.ones(())])

    sums = load(mesh, x, density, {"nu": nu})
    bent = jnp.sqrt(jnp.max(nodal_weingarten_squared(mesh, x, nu)))
    return x + (sums[:, 0] / sums[:, 1])[:, None] * nu, bent

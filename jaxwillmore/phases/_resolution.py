r"""Whether a mesh can carry an interface.

The energy of one interface on quadratic elements is off by about $6\cdot10^{-4} (\ell/h)^{-4}$ with
$h = \sqrt{A/\text{nodes}}$; cubic ones do as well per node, and linear ones need $\ell > 2h$ for
$10^{-3}$. Where a mesh is stretched, $h$ across the interface counts.
"""

import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ..surface import area

WARN_BELOW = 0.7
"""Widths per distance of nodes below which the line energy is off by more than 2e-3."""

REFUSE_BELOW = 0.4
"""Widths per distance of nodes below which an interface sticks to the mesh."""


def resolution(mesh: SurfaceMesh, x: Float[Array, "nodes 3"], width) -> Float[Array, ""]:
    r"""$\ell/h$: the width of an interface over the distance $h = \sqrt{A/\text{nodes}}$ of nodes.

    **Arguments:**

    - `width`: $\ell$ of the profile $1/(1 + e^{-s/\ell})$, length.
    """
    return width / jnp.sqrt(area(mesh, x) / mesh.n_nodes)


def checked_width(mesh: SurfaceMesh, x: Float[Array, "nodes 3"], width) -> Float[Array, ""]:
    """The width as an array; tracers pass unchecked.

    **Raises:** `ValueError` unless it is at least `REFUSE_BELOW` distances of nodes.
    """
    nodes = resolution(mesh, x, width)
    # Not "<": a width that is not a number is refused too.
    if not isinstance(nodes, Tracer) and not nodes >= REFUSE_BELOW:
        h = float(jnp.sqrt(area(mesh, x) / mesh.n_nodes))
        raise ValueError(
            f"An interface on this mesh needs a width of at least {REFUSE_BELOW} h = "
            f"{REFUSE_BELOW * h:.3g}, and {h:.3g} for an energy to 1e-3, where h = {h:.3g} is the "
            f"distance of its nodes; got {width}. Refine the mesh, or take a wider interface."
        )
    return jnp.asarray(width, float)

"""The shape derivative of any number that depends on a surface."""

from collections.abc import Callable, Mapping

import jax
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh


def shape_derivative(
    energy: Callable[..., Float[Array, "..."]],
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    direction: Float[Array, "_ 3"],
    fields: Mapping[str, Array] | None = None,
) -> Float[Array, "..."]:
    r"""$\mathrm{d}E(x)[\phi] = \frac{\mathrm{d}}{\mathrm{d}t} E(x + t\phi)|_{t=0}$, by JAX.

    The derivative of the discrete energy, to rounding. That it converges to the formula of the
    smooth surface, for instance $\int (-\Delta H + \tfrac12 H^3 - H|A|^2)\,\phi\cdot\nu$ for
    `Willmore`, is what `jaxwillmore verify shape-derivative` shows.

    **Arguments:**

    - `energy`: an energy, or any function of `(mesh, x)`, such as `surface.volume`.
    - `direction`: the velocity $\phi$ of the nodes, length.
    - `fields`: nodal arrays of the moment for an energy that reads some; they stay on their nodes.

    **Raises:** `ValueError` unless `direction` has the shape of `x`.

    ```python
    slope = jw.energies.shape_derivative(jw.energies.Willmore(), mesh, x, V[:, None] * nu)
    ```
    """
    if direction.shape != x.shape:
        raise ValueError(
            f"`direction` needs one vector per node, shape {x.shape}; got {direction.shape}."
        )
    rest = () if fields is None else (fields,)
    return jax.jvp(lambda x: energy(mesh, x, *rest), (x,), (direction,))[1]

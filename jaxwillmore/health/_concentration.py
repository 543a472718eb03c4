"""What speaks against a concentration on a surface."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ..phases import WARN_BELOW, amount as amount_of, resolution
from ._warnings import HealthWarning

# Pure phases are 0 and 1; an interface that is resolved overshoots by less.
OVERSHOOT = 0.05
# Relative change of an amount that is held to the tolerance of Newton's method.
DRIFT = 1e-6


def concentration_warnings(
    mesh: SurfaceMesh,
    x: Float[Array | np.ndarray, "nodes 3"],
    c: Float[Array | np.ndarray, " nodes"],
    *,
    width: float | None = None,
    amount: float | None = None,
    moduli: Any = None,
) -> tuple[HealthWarning, ...]:
    r"""Reasons not to believe a concentration; none is a good sign.

    **Arguments:**

    - `width`: $\ell$ of the profile $1/(1 + e^{-s/\ell})$, length.
    - `amount`: what $\int c$ should be.
    - `moduli`: a function of $c$ that must stay positive (a bending modulus).
    """
    c, found = np.asarray(c), []
    if not np.all(np.isfinite(c)):
        count = float(np.count_nonzero(~np.isfinite(c)))
        return (HealthWarning("not_finite", count, 0.0, "The concentration is not finite."),)
    if width is not None:
        nodes = float(resolution(mesh, jnp.asarray(x), width))
        if nodes < WARN_BELOW:
            text = (
                f"The interface is {nodes:.2g} distances of nodes wide: its energy is off by a "
                "percent or more, and it may stick to the mesh. Refine the mesh, or take a wider "
                "one."
            )
            found.append(HealthWarning("unresolved_interface", nodes, WARN_BELOW, text))
    outside = max(-float(c.min()), float(c.max()) - 1.0)
    if outside > OVERSHOOT:
        text = f"c reaches from {c.min():.3g} to {c.max():.3g}; the pure phases are 0 and 1."
        found.append(HealthWarning("concentration_outside", outside, OVERSHOOT, text))
    if amount is not None:
        now = float(amount_of(mesh, jnp.asarray(x), jnp.asarray(c)))
        drift = abs(now - amount) / max(abs(amount), 1e-300)
        if drift > DRIFT:
            text = f"The amount was {amount:.8g} and is {now:.8g}, though the law holds it."
            found.append(HealthWarning("amount_drift", drift, DRIFT, text))
    if isinstance(moduli, Callable):
        least = float(np.min(np.asarray(moduli(jnp.asarray(c)))))
        if least <= 0:
            text = f"The bending modulus is {least:.3g} where c is farthest from its wells."
            found.append(HealthWarning("negative_modulus", least, 0.0, text))
    return tuple(found)

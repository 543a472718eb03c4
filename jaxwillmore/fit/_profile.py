"""The misfit along one parameter while all other unknowns follow."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._flow_fit import FlowFit
from ._shape_fit import ShapeFit


def profile(
    fit: ShapeFit | FlowFit, label: str, values: Float[np.ndarray, " values"]
) -> Float[np.ndarray, " values"]:
    r"""Root mean square residual, over that of the fit, at given values of one free parameter.

    The other unknowns, motion included, follow along the valley of the quadratic model at the
    solution; the residuals there are those of the model itself. NaN where it has no solution.

    **Raises:** `ValueError` for a label that is not free.
    """
    labels, ranges = fit.residuals.labels, fit.residuals.ranges
    if label not in labels:
        raise ValueError(f"`label` must be one of {', '.join(labels)}; got {label!r}.")
    k = labels.index(label)
    J = fit.jacobian
    rest = np.delete(np.arange(J.shape[1]), k)
    follow = -np.linalg.lstsq(J[:, rest], J[:, k], rcond=1e-8)[0]
    best = np.asarray(fit.u)
    least = fit.misfit(fit.u)[0]
    found = []
    for value in np.asarray(values, float):
        change = ranges[k].unknown(float(value)) - best[k]
        u = best.copy()
        u[k] += change
        u[rest] += follow * change
        size, solved = fit.misfit(jnp.asarray(u))
        found.append(size / max(least, 1e-300) if solved else np.nan)
    return np.array(found)

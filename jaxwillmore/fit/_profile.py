"""The misfit along one parameter while all other unknowns follow."""

import equinox as eqx
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
    misfit = eqx.filter_jit(_misfit)
    least = float(misfit(fit.residuals, fit.u)[0])
    found = []
    for value in np.asarray(values, float):
        change = ranges[k].unknown(float(value)) - best[k]
        u = best.copy()
        u[k] += change
        u[rest] += follow * change
        size, solved = misfit(fit.residuals, jnp.asarray(u))
        found.append(float(size) / max(least, 1e-300) if bool(solved) else np.nan)
    return np.array(found)


def _misfit(residuals, u):
    r, aux = residuals(u)
    return jnp.linalg.norm(r), aux.solved

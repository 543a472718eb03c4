"""The misfit along one parameter, least over all other unknowns."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._descend import Evaluated, evaluate, explained

# Steps for one value, and how one that does not help is shortened.
MOST, FIRST_DAMPING, FACTOR = 15, 1e-3, 10.0
# Steps that bring less than this part of what the linear model promises lie in a kink of the
# distance; after so many of them no more is to be had.
POOR, PATIENCE = 0.1, 3


@runtime_checkable
class Fitted(Protocol):
    """The end of a fit: a problem of least squares, and its solution."""

    @property
    def residuals(self) -> Any:
        """The problem; its first unknowns are parameters with `labels` and `ranges`."""
        ...

    @property
    def u(self) -> Float[Array, " unknowns"]:
        """The solution."""
        ...


class _Place(NamedTuple):
    """Unknowns, and what the problem says there."""

    u: np.ndarray
    seen: Evaluated

    @property
    def size(self) -> float:
        return float(np.linalg.norm(self.seen.residuals))


def profile(
    fit: Fitted,
    label: str,
    values: Float[np.ndarray, " values"],
    *,
    tolerance: float = 0.1,
) -> Float[np.ndarray, " values"]:
    r"""Root mean square residual, over that of the fit, at given values of one free parameter.

    $$ p(\theta_k) = \min_{\theta_j,\; j \ne k} |r(\theta)| \;/\; |r(\hat\theta)| $$

    At each value all other unknowns, motion included, are fitted again by damped Gauss–Newton
    steps that begin along the valley at the neighbouring value nearer to the fit. With a variance
    $s^2$ of the residuals the profile likelihood falls by $|r(\hat\theta)|^2 (p^2 - 1)/2s^2$,
    which is $\frac12 t^2$ at t standard errors of a well determined parameter; where the two part,
    read intervals from the profile.

    **Arguments:**

    - `fit`: a `ShapeFit`, `FlowFit` or `PhaseFit`. Its compiled program serves all values.
    - `label`: a free parameter, as in `fit.identification.names`.
    - `values`: of that parameter, in any order, in its own unit.
    - `tolerance`: how far from the minimum the others may be left, in standard errors: the default
      leaves $\chi^2$ too high by at most 0.01.

    **Returns:** one number for each value, at least 1 if the fit is at its minimum; NaN where the
    model has no solution.

    **Raises:** `ValueError` for a label that is not free, and for values outside of its range.

    *Limits:* on the frozen reference of the end of the fit: far from it the error of the mesh
    grows. The minimum is the one that is connected with the fit.

    ??? cite "Reference"
        Bates, Watts (1988), *Nonlinear Regression Analysis and its Applications*, section 6.1.2.
    """
    labels, ranges = fit.residuals.labels, fit.residuals.ranges
    if label not in labels:
        raise ValueError(f"`label` must be one of {', '.join(labels)}; got {label!r}.")
    k = labels.index(label)
    try:
        wanted = np.array([ranges[k].unknown(float(v)) for v in np.asarray(values, float)])
    except ValueError as error:
        raise ValueError(f"`values` of `{label}`: {error}") from None
    best = _at(fit.residuals, np.asarray(fit.u))
    found = np.full(len(wanted), np.nan)
    for side in (wanted >= best.u[k], wanted < best.u[k]):
        here = best
        (places,) = np.nonzero(side)
        for place in places[np.argsort(np.abs(wanted[places] - best.u[k]), kind="stable")]:
            there = _least(fit.residuals, here, k, float(wanted[place]), tolerance)
            if there is not None:
                here = there
                found[place] = there.size / max(best.size, 1e-300)
    return found


def _at(residuals, u) -> _Place:
    return _Place(u, evaluate(residuals, jnp.asarray(u)))


def _least(residuals, near: _Place, k: int, value: float, tolerance: float) -> _Place | None:
    """The least misfit with one unknown held at a value; `None` where there is no model."""
    rest = np.delete(np.arange(len(near.u)), k)
    J, change = near.seen.jacobian, value - near.u[k]
    along, still = near.u.copy(), near.u.copy()
    along[k] = still[k] = value
    along[rest] -= np.linalg.lstsq(J[:, rest], J[:, k], rcond=1e-8)[0] * change
    here = _at(residuals, along)
    if not _good(here):
        here = _at(residuals, still)
    if not _good(here):
        return None
    damping, poor = 0.0, 0
    for _ in range(MOST):
        r, J = here.seen.residuals, here.seen.jacobian[:, rest]
        part = explained(r, J)
        # One standard error explains a part 1/√rows of residuals that are noise.
        if part * np.sqrt(np.count_nonzero(r)) < tolerance or poor >= PATIENCE:
            break
        u = here.u.copy()
        u[rest] -= _step(J, r, damping)
        there = _at(residuals, u)
        gain = 1 - (there.size / here.size) ** 2 if _good(there) else -1.0
        poor += gain < POOR * part**2
        if gain > 0:
            here, damping = there, damping / FACTOR if damping > FIRST_DAMPING else 0.0
        else:
            damping = max(FIRST_DAMPING, FACTOR * damping)
    return here


def _step(J, r, damping):
    """The step of Levenberg and Marquardt, with the columns of J for a scale."""
    scale = np.sqrt(damping) * np.diag(np.linalg.norm(J, axis=0))
    rows = np.concatenate([J, scale]), np.concatenate([r, np.zeros(len(scale))])
    return np.linalg.lstsq(*rows, rcond=1e-8)[0]


def _good(place: _Place) -> bool:
    return bool(place.seen.aux.solved) and bool(np.all(np.isfinite(place.seen.residuals)))

"""What the parameters of a fit are at its end, how sure they are, and whether it succeeded."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._descend import Descent
from ._identify import Identification
from ._parameters import AbstractRange, Positive
from ._results import RESULTS
from ._statistics import laplace

# A parameter whose change by its own size changes the data by less than this part is not seen,
# whatever the residuals are.
UNSEEN = 1e-6


@runtime_checkable
class Named(Protocol):
    """Residuals whose first unknowns are parameters with names and ranges."""

    labels: tuple[str, ...]
    ranges: tuple[AbstractRange, ...]


class Conclusion(NamedTuple):
    """Parameters and their statistics, residuals and derivative there, and how the fit ended."""

    parameters: dict[str, float]
    identification: Identification
    residuals: Float[np.ndarray, " rows"]
    jacobian: Float[np.ndarray, "rows unknowns"]
    result: RESULTS


def start_of(
    start: Mapping[str, float], ranges: tuple[AbstractRange, ...]
) -> Float[Array, " parameters"]:
    """The unknowns of given parameters.

    **Raises:** `ValueError` for none at all, and for a value out of its range.
    """
    if len(start) == 0:
        raise ValueError("`start` is empty; name at least one parameter.")
    u = []
    for (name, value), allowed in zip(start.items(), ranges, strict=True):
        try:
            u.append(allowed.unknown(float(value)))
        except ValueError as error:
            raise ValueError(f"Start of `{name}`: {error}") from None
    return jnp.asarray(u)


def values_of(residuals: Named, u: Float[Array, " unknowns"]) -> dict[str, Array]:
    """Parameters by name."""
    each = zip(residuals.labels, residuals.ranges, strict=True)
    return {name: allowed.value(u[k]) for k, (name, allowed) in enumerate(each)}


def concluded(residuals: Named, descent: Descent, lost: bool, least: float, **data: Any):
    """The conclusion of a descent; of a `lost` one, without a solution, it says nothing.

    **Arguments:**

    - `least`: norm of the residuals that a change by `UNSEEN` would make.
    - `data`: `count`, `variance` and `rank_tolerance` of `laplace`.
    """
    u, ranges = descent.u, residuals.ranges
    result = RESULTS.stalled if descent.result is None else descent.result
    r, J = descent.residuals, descent.jacobian
    if lost:
        r, J = np.zeros(len(r)), np.zeros(J.shape)
    values = {name: float(value) for name, value in values_of(residuals, u).items()}
    slopes = [float(eqx.filter_grad(q.value)(u[k])) for k, q in enumerate(ranges)]
    found = laplace(
        r,
        J,
        residuals.labels,
        np.array(list(values.values())),
        np.array(slopes),
        least=least,
        by_factors=tuple(isinstance(q, Positive) for q in ranges),
        **data,
    )
    if bool(result == RESULTS.converged):
        if any(q.on_bound(v) for q, v in zip(ranges, values.values(), strict=True)):
            result = RESULTS.on_bound
        elif not all(found.identifiable.values()):
            result = RESULTS.not_identifiable
    return Conclusion(values, found, r, J, result)

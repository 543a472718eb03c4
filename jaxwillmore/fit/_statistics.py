"""The statistics of a nonlinear fit at its minimum."""

import numpy as np
from jaxtyping import Float, Int

from ._identify import Identification, identify


def laplace(
    residuals: Float[np.ndarray, " rows"],
    jacobian: Float[np.ndarray, "rows unknowns"],
    names: tuple[str, ...],
    values: Float[np.ndarray, " names"],
    slopes: Float[np.ndarray, " names"],
    *,
    count: int,
    variance: float | None = None,
    rank_tolerance: float = 1e-3,
    least: float = 0.0,
    by_factors: tuple[bool, ...] = (),
) -> Identification:
    r"""Identification of the first unknowns, with the others, the motion, fitted along.

    The columns of the motion are projected out, so that a parameter which only moves the surface
    about counts as null.

    **Arguments:**

    - `jacobian`: by all unknowns; the first ones belong to `names`.
    - `slopes`: derivatives of the named values by their unknowns.
    - `count`: number of residuals that are no padding.
    - `variance`: of a residual; left out, it is their mean square over `count` less the number of
      unknowns.
    - `least`: a parameter counts as null if a unit of its unknown changes the residuals by no more:
      what a single parameter does has nothing to be compared with.
    - `by_factors`: which unknowns are logarithms. Such a parameter counts as null also if it is
      uncertain by more than a factor of e.
    """
    n = len(names)
    own, motion = jacobian[:, :n] / slopes[None], jacobian[:, n:]
    Q, s, _ = np.linalg.svd(motion, full_matrices=False)
    Q = Q[:, s > 1e-6 * s[0]] if len(s) else Q
    own = own - Q @ (Q.T @ own)
    mean_square = float(residuals @ residuals) / max(count - jacobian.shape[1], 1)
    scale = mean_square if variance is None else variance
    needed = least + np.sqrt(scale) * np.asarray(by_factors or n * (False,))
    own = np.where(np.linalg.norm(own, axis=0) * np.abs(slopes) > needed, own, 0.0)
    return identify(own, names, values, variance=scale, rank_tolerance=rank_tolerance)


def patches_of(
    points: Float[np.ndarray, "points 3"], levels: int = 6
) -> Int[np.ndarray, " points"]:
    """Numbers of 2^levels patches of equally many points, by halving along the longest extent."""
    number = np.zeros(len(points), int)
    for level in range(levels):
        for patch in range(2**level):
            (inside,) = np.nonzero(number == patch)
            if len(inside) < 2:
                continue
            axis = np.argmax(np.ptp(points[inside], axis=0))
            order = inside[np.argsort(points[inside, axis], kind="stable")]
            number[order[len(order) // 2 :]] += 2**level
    return number

"""How far the discrepancy of a model may move its parameters: residuals resampled in blocks."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import sph_harm_y

from ..mesh import SurfaceMesh, icosphere
from ..surface import closest

DRAWS = 2000
# The largest degree of the waves of distances, and the least number of rows for each of them.
MOST_DEGREE, ROWS_PER_WAVE = 8, 4


class Field(NamedTuple):
    """How the rows of one target lie on its surface.

    **Attributes:**

    - `waves`: spherical harmonics at the rows times the weights of the rows, degree by degree.
    - `patches`: a number for every row; what is left beside the waves is independent from patch
      to patch.
    """

    waves: Float[np.ndarray, "rows harmonics"]
    patches: Int[np.ndarray, " rows"]


def block_bootstrap(
    residuals: Float[np.ndarray, " rows"],
    jacobian: Float[np.ndarray, "rows unknowns"],
    influence: Float[np.ndarray, "names rows"],
    fields: Sequence[Field],
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> Float[np.ndarray, "draws names"]:
    r"""Changes of the parameters when residuals that depend on their neighbours are drawn again.

    A residual r at the minimum may as well have been another field of the same statistics, $r^*$.
    Then the fit would have moved by $J^+ r^*$: no fit is repeated. The blocks are the degrees l of
    spherical harmonics of the residual field of each target,

    $$ r = \sum_l Q_l a_l + e, \qquad r^* = \sum_l s_l Q_l \xi_l + \sum_p \pm e_p, $$

    with $\xi_l$ turned at random in the $2l + 1$ dimensions of its degree, and the rest e with a
    random sign on every patch. Targets are independent of each other. The power $s_l^2$ per
    dimension does not rise with l (the least-squares fit of that kind to what is seen), for a fit
    takes most of the low degrees out of its residuals: power is counted over the dimensions that
    are left, and a degree without any takes that of the next.

    **Arguments:**

    - `residuals`, `jacobian`: at the minimum, the latter by all unknowns.
    - `influence`: what a unit of every residual moves of each parameter, the rows of $J^+$.
    - `fields`: one for each target, in the order of the rows.
    - `draws`, `seed`: how many, and which; the same seed gives the same draws.

    *Limits:* the field is taken for isotropic, a matter of its degrees alone. Of one cell a low
    degree has few dimensions, so that its power is known within a factor of two at best.

    ??? cite "Reference"
        Künsch (1989), *Ann. Statist.* 17, 1217–1241: blocks for dependent data. Davison, Hinkley
        (1997), *Bootstrap Methods and their Application*, sections 8.2.3–8.2.4 (blocks, random
        phases at fixed power) and 6.2.3 (leverage). Liu (1988), *Ann. Statist.* 16, 1696–1708:
        random signs.
    """
    rng = np.random.default_rng(seed)
    fitted = _orthonormal(jacobian)
    moved, used = np.zeros((draws, len(influence))), 0
    for field in fields:
        rows = slice(used, used + len(field.waves))
        used = rows.stop
        Q, F, r = np.linalg.qr(field.waves)[0], fitted[rows], residuals[rows]
        power = _power(Q.T @ r, np.sum((Q.T @ F) ** 2, axis=1))
        for degree, size in enumerate(power):
            own = slice(degree**2, (degree + 1) ** 2)
            xi = rng.normal(size=(draws, 2 * degree + 1))
            xi *= np.sqrt((2 * degree + 1) * size) / np.linalg.norm(xi, axis=1)[:, None]
            moved += xi @ (influence[:, rows] @ Q[:, own]).T
        # With other signs the rest would have waves: those are drawn above.
        beside = influence[:, rows] - (influence[:, rows] @ Q) @ Q.T
        moved += _signed(_rest(Q, F, r), beside, field.patches, draws, rng)
    return moved


def sphere_directions(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], points: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, "points 3"]:
    """Where on the sphere points lie of which a model, the image of an icosphere, is the image."""
    n = np.asarray(icosphere(round(np.log(mesh.n_cells / 20) / np.log(4)), mesh.degree)[1])
    cells = np.asarray(mesh.cells)
    cell, basis = closest(cells, np.asarray(x), points)
    found = np.einsum("pj,pjd->pd", basis[..., 0], n[cells[cell]])
    return found / np.linalg.norm(found, axis=1)[:, None]


def waves_at(
    directions: Float[np.ndarray, "rows 3"],
    weights: Float[np.ndarray, " rows"],
    patches: Int[np.ndarray, " rows"],
) -> Field:
    """Real spherical harmonics at the directions, as many degrees as the rows can tell."""
    rows = np.count_nonzero(weights)
    most = min(MOST_DEGREE, int(np.sqrt(rows / ROWS_PER_WAVE)) - 1)
    polar, azimuth = np.arccos(np.clip(directions[:, 2], -1, 1)), np.arctan2(*directions.T[1::-1])
    waves = []
    for degree in range(most + 1):
        waves.append(sph_harm_y(degree, 0, polar, azimuth).real)
        for m in range(1, degree + 1):
            wave = np.sqrt(2) * sph_harm_y(degree, m, polar, azimuth)
            waves += [wave.real, wave.imag]
    return Field(np.stack(waves, axis=1) * weights[:, None], patches)


def _orthonormal(jacobian):
    """A basis of what the unknowns can do."""
    U, s, _ = np.linalg.svd(jacobian, full_matrices=False)
    return U[:, s > 1e-8 * s[0]]


def _power(a, taken) -> Float[np.ndarray, " degrees"]:
    """Power per dimension of every degree, which does not rise; `taken` is what was fitted away.

    Pool adjacent violators: neighbours that rise are one.
    """
    pools: list[list[float]] = []  # sum of squares, dimensions, number of degrees
    for degree in range(round(np.sqrt(len(a)))):
        own = slice(degree**2, (degree + 1) ** 2)
        left = float(np.sum(1.0 - taken[own]))
        pools.append([float(np.sum(a[own] ** 2)), left, 1.0])
        while len(pools) > 1 and _rises(pools[-2], pools[-1]):
            last = pools.pop()
            pools[-1] = [one + other for one, other in zip(pools[-1], last, strict=True)]
    return np.concatenate([np.full(int(n), s / max(left, 1e-300)) for s, left, n in pools])


def _rises(before, after) -> bool:
    # Less than half a dimension tells no power of its own.
    return before[1] < 0.5 or before[0] * after[1] <= after[0] * before[1]


def _rest(Q, F, r):
    """What is no wave, as large as it was before the fit."""
    count = np.count_nonzero(r) - Q.shape[1]
    taken = np.sum(F**2) - np.sum((Q.T @ F) ** 2)
    return (r - Q @ (Q.T @ r)) * np.sqrt(max(count, 1) / max(count - taken, 1))


def _signed(rest, influence, patches, draws, rng):
    """What the rest moves with a random sign on every patch."""
    numbers, place = np.unique(patches, return_inverse=True)
    scores = np.zeros((len(numbers), len(influence)))
    np.add.at(scores, place, (influence * rest).T)
    return rng.choice(np.array([-1.0, 1.0]), size=(draws, len(numbers))) @ scores

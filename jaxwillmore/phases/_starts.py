"""Concentrations to start from; made on the host, with the amount exact."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import root_scalar
from scipy.spatial import KDTree
from scipy.special import expit

from ..fem import load
from ..mesh import SurfaceMesh
from ..surface import area, inertia_tensor
from ._amount import check_mean, with_mean
from ._interface import level_segments
from ._resolution import checked_width

# Segments of the interface tried for every node.
_CANDIDATES = 8


def spinodal(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], mean, amplitude: float = 0.05, seed: int = 0
) -> Float[Array, " nodes"]:
    """A mixture with noise: `mean` with a random number on every node, which then demixes.

    The numbers are uniform in ± `amplitude` and the same on every platform. They belong to the
    nodes, so that another mesh starts from other noise.

    **Raises:** `ValueError` unless the mean lies between 0 and 1, and the noise with it.
    """
    check_mean(mean)
    most = min(mean, 1 - mean)
    if not 0 <= amplitude <= most:
        raise ValueError(
            f"`amplitude` must lie between 0 and {most:g}, or c leaves [0, 1]; got {amplitude}."
        )
    noise = np.random.default_rng(seed).uniform(-amplitude, amplitude, mesh.n_nodes)
    return with_mean(mesh, jnp.asarray(x, float), jnp.asarray(mean + noise), mean)


def stripe(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    width,
    mean=0.5,
    axis: Float[Array | np.ndarray, "3"] | None = None,
) -> Float[Array, " nodes"]:
    r"""One interface across the surface: phase 1 on its upper side, phase 0 on the lower.

    $c = 1/(1 + e^{-s/\ell})$ with the signed distance $s$ from the line in which a plane cuts the
    surface: the profile in equilibrium. The plane is moved until the amount is exact.

    **Arguments:**

    - `width`: $\ell$, length.
    - `mean`: $\int c$ over the area.
    - `axis`: normal of the plane, towards phase 1; the longest principal axis of the body if left
      out, a coordinate axis (z, x, y in this order) where several are as long.

    **Raises:** `ValueError` for a mean outside of what an interface of this width leaves on the
    surface, for a width below `REFUSE_BELOW` distances of nodes, and for an axis of length 0.
    """
    return caps(mesh, x, width, mean, 1, axis)


def caps(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    width,
    mean,
    n: int = 2,
    axis: Float[Array | np.ndarray, "3"] | None = None,
) -> Float[Array, " nodes"]:
    """Phase 1 in caps at both ends of an axis, or at its upper end for `n` = 1.

    The planes that cut off the caps stand at equal distances from the ends, and move together until
    the amount is exact. Arguments and errors as in `stripe`.
    """
    if n not in (1, 2):
        raise ValueError(f"`n` must be 1 or 2 caps; got {n!r}.")
    check_mean(mean)
    x = jnp.asarray(x, float)
    width = float(checked_width(mesh, x, width))
    height = x @ jnp.asarray(_axis(mesh, x, axis))
    low, high = float(jnp.min(height)), float(jnp.max(height))
    share = np.asarray(load(mesh, x, lambda _, __, phi, ___: phi)) / float(area(mesh, x))

    def start(depth: float) -> np.ndarray:
        c = expit(_distance(mesh, x, height, high - depth) / width)
        if n == 2:
            c = c + expit(_distance(mesh, x, -height, -(low + depth)) / width)
        return c

    # Not the ends themselves: a plane there does not cut the surface.
    span = (high - low) * np.array([1e-6, 1 - 1e-6 if n == 1 else 0.5])
    c = start(_depth(lambda d: float(share @ start(d)), mean, span))
    # What is left are steps of the distance by rounding.
    return with_mean(mesh, x, jnp.asarray(c), mean)


def _depth(mean_at: Callable[[float], float], mean, span) -> float:
    """Where the mean is what it should be."""
    least, most = mean_at(span[0]), mean_at(span[1])
    if not least < mean < most:
        raise ValueError(
            f"`mean` must lie between {least:.3g} and {most:.3g} for an interface of this width on "
            f"this surface; got {mean}."
        )
    excess = lambda d: mean_at(d) - mean
    return root_scalar(excess, bracket=span, method="brentq", xtol=1e-13 * span[1]).root


def _distance(mesh, x, height, level: float) -> Float[np.ndarray, " nodes"]:
    """Distance of the nodes from the line at a height, positive above it.

    The chord: shorter than the way on the surface by a part s²/24R², 4e-3 where s is three tenths
    of the radius of curvature.
    """
    segments = np.asarray(level_segments(mesh, x, height, jnp.asarray(level)))
    segments = segments[np.any(segments[:, 0] != segments[:, 1], axis=1)]
    nodes, height = np.asarray(x), np.asarray(height)
    count = min(_CANDIDATES, len(segments))
    near = KDTree(segments.mean(axis=1)).query(nodes, count)[1].reshape(len(nodes), count)
    p, along = segments[near, 0], segments[near, 1] - segments[near, 0]
    share = np.sum((nodes[:, None] - p) * along, axis=-1) / np.sum(along**2, axis=-1)
    foot = p + np.clip(share, 0.0, 1.0)[..., None] * along
    distance = np.min(np.linalg.norm(nodes[:, None] - foot, axis=-1), axis=1)
    return np.sign(height - level) * distance


def _axis(mesh, x, axis) -> Float[np.ndarray, "3"]:
    """A unit vector: as given, or along the body."""
    if axis is not None:
        given = np.asarray(axis, float)
        length = np.linalg.norm(given)
        if given.shape != (3,) or not 0 < length < np.inf:
            raise ValueError(f"`axis` must be a vector of three numbers, not zero; got {axis!r}.")
        return given / length
    moments, vectors = np.linalg.eigh(np.asarray(inertia_tensor(mesh, x)))
    inertia = vectors @ np.diag(moments) @ vectors.T
    # On bodies of revolution the eigenvectors would be made of rounding errors.
    for k in (2, 0, 1):
        if inertia[k, k] < moments[0] + 1e-3 * moments[2]:
            return np.eye(3)[k]
    longest = vectors[:, 0]
    return longest * np.sign(longest[np.argmax(np.abs(longest))])

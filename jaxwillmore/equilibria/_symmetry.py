"""The symmetry of a shape, as far as two numbers tell it, and names of modes by it."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ..surface import area, centroid

# A body of revolution, or one with a centre, to this part of its size.
SYMMETRIC = 1e-3
# Rings in which the angular dependence of a mode is measured.
RINGS = 12
HIGHEST = 8


class Symmetry(NamedTuple):
    """How far a shape is from a body of revolution, and from one with a centre of symmetry."""

    biaxiality: float
    r"""Difference of the two principal second moments $\int r r'$ of the surface that are nearest
    to each other, over their mean: 0 for a body of revolution."""
    polarity: float
    r"""Size of the third moments $\int r\otimes r\otimes r$ over $|\Gamma| R^3$: 0 for a shape with
    a centre of symmetry, such as every prolate and oblate, and not for a pear or a bowl."""


@eqx.filter_jit
def _moments(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]):
    middle = centroid(mesh, x)

    def density(point, _):
        r = point.position - middle
        second = jnp.einsum("i,j->ij", r, r)
        third = jnp.einsum("i,j,k->ijk", r, r, r)
        return jnp.concatenate([second.reshape(-1), third.reshape(-1)])

    both = integrate(mesh, x, density)
    values, axes = jnp.linalg.eigh(both[:9].reshape(3, 3))
    return values, axes, both[9:], middle, area(mesh, x)


def symmetry(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Symmetry:
    """Measure a surface."""
    values, _, third, _, size = (np.asarray(value) for value in _moments(mesh, x))
    gap = min(values[1] - values[0], values[2] - values[1])
    R = np.sqrt(size / (4 * np.pi))
    return Symmetry(float(gap / np.mean(values)), float(np.linalg.norm(third) / (size * R**3)))


def lost(before: Symmetry, after: Symmetry) -> tuple[str, ...]:
    """What a shape has lost on its way from one surface to another, in words."""
    names = ("body of revolution", "centre of symmetry")
    pairs = zip(names, before, after, strict=True)
    return tuple(name for name, a, b in pairs if a < SYMMETRIC and b > 10 * max(a, SYMMETRIC))


def mode_name(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], modes: Float[np.ndarray, "nodes modes"]
) -> str:
    """The modes of a body of revolution as `cos mφ` and the parity along its axis; else nothing."""
    values, axes, _, middle, _ = (np.asarray(value) for value in _moments(mesh, x))
    gaps = np.diff(values)
    if min(gaps) > 0.02 * np.mean(values):
        return ""
    axis = axes[:, 2] if gaps[0] < gaps[1] else axes[:, 0]
    r = np.asarray(x) - middle
    across = np.linalg.svd(axis[None])[2][1:]
    height, angle = r @ axis, np.arctan2(*(across @ r.T))
    # Rings of about equally many nodes, symmetric about the middle.
    rank = np.argsort(np.argsort(height, kind="stable"), kind="stable")
    ring = np.minimum(rank * RINGS // len(rank), RINGS - 1)
    orders = np.arange(HIGHEST + 1)
    wave = np.exp(-1j * orders[:, None] * angle)
    inside = (ring == np.arange(RINGS)[:, None]).astype(float)
    parts = np.einsum("rn,on,nm->orm", inside, wave, modes)
    power = np.sum(np.abs(parts) ** 2, axis=(1, 2)) * np.where(orders > 0, 2, 1)
    m = int(np.argmax(power))
    mirrored = np.sum((parts[m] * np.conj(parts[m][::-1])).real)
    parity = "even" if mirrored > 0 else "odd"
    return f"m = 0, {parity}" if m == 0 else f"cos {'' if m == 1 else m}φ, {parity}"

"""Surfaces that a fit may start from, and the family that a shape belongs to."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import brentq

from ..equilibria import spheroid, symmetry
from ..mesh import SurfaceMesh, from_sphere_map
from ..surface import area, inertia_tensor, reduced_volume

PROLATE, OBLATE, BOWL = KINDS = ("prolate", "oblate", "stomatocyte")
# Above this reduced volume there is no stomatocyte at H0 = 0.
BOWL_BELOW = 0.66
# Third moments over |Γ| R0³ of a shape that is open on one side; an oblate has none.
POLAR = 0.002
# Half the angle of the sphere that a bowl is bent around.
WRAP = 2.0


def start_surface(
    kind: str, volume: float, level: int
) -> tuple[SurfaceMesh, Float[Array, "nodes 3"]]:
    """A spheroid or a bowl of unit area radius and a given reduced volume."""
    return bowl(volume, level) if kind == BOWL else spheroid(volume, kind, level)


def bowl(volume: float, level: int, degree: int = 2) -> tuple[SurfaceMesh, Float[Array, "nodes 3"]]:
    """A disc bent around a sphere, open above: the image of an icosphere.

    **Raises:** `ValueError` for a reduced volume out of (0.3, 0.85).
    """
    if not 0.3 < volume < 0.85:
        raise ValueError(f"A bowl has a reduced volume in (0.3, 0.85); got {volume!r}.")

    def nodes(thickness: float):
        def point(n):
            square = n[0] ** 2 + n[1] ** 2
            angle = WRAP * jnp.sqrt(jnp.where(square > 0, square, 1.0))
            # sin(angle)/ρ, which is smooth on the axis
            turned = jnp.where(square > 0, WRAP * jnp.sin(angle) / angle, WRAP)
            along = jnp.where(square > 0, jnp.cos(angle), 1.0)
            R = 1 / WRAP + thickness * n[2]
            return R * jnp.stack([turned * n[0], turned * n[1], along])

        return from_sphere_map(point, level, degree)

    off = lambda thickness: float(reduced_volume(*nodes(thickness))) - volume
    mesh, x = nodes(float(np.asarray(brentq(off, 0.05, 0.95 / WRAP, xtol=1e-6))))
    return mesh, x * jnp.sqrt(4 * jnp.pi / area(mesh, x))


def kind_of(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> str:
    """The family of shapes by polarity, and by the middle one of the principal axes."""
    if symmetry(mesh, x).polarity > POLAR:
        return BOWL
    low, middle, high = np.linalg.eigvalsh(np.asarray(inertia_tensor(mesh, x)))
    # Two large moments of inertia and a small one: a cigar.
    return PROLATE if high - middle < middle - low else OBLATE

"""Start surfaces: spheroids of a given reduced volume."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import brentq

from ..mesh import SurfaceMesh, ellipsoid
from ..surface import area, reduced_volume


def spheroid(
    reduced_volume: float, kind: str = "prolate", level: int = 2, degree: int = 2
) -> tuple[SurfaceMesh, Float[Array, "nodes 3"]]:
    """The spheroid of unit area radius with a given reduced volume: a start for `equilibrium`.

    **Arguments:**

    - `reduced_volume`: between 0.2 and 1, exclusive.
    - `kind`: `"prolate"` (a cigar) or `"oblate"` (a disc).
    - `level`, `degree`: as in `jaxwillmore.mesh.icosphere`. Degree 4 on level 1 (642 nodes) is
      nearer to a smooth vesicle than degree 2 on level 3 (2,562), in a quarter of the time.

    **Raises:** `ValueError` for a reduced volume out of range or an unknown kind.
    """
    if not 0.2 < reduced_volume < 1:
        raise ValueError(f"`reduced_volume` must lie in (0.2, 1); got {reduced_volume!r}.")
    if kind not in ("prolate", "oblate"):
        raise ValueError(f"`kind` must be 'prolate' or 'oblate'; got {kind!r}.")
    low, high = (1.0, 60.0) if kind == "prolate" else (1e-3, 1.0)
    found = brentq(lambda c: c / _area(c) ** 1.5 - reduced_volume, low, high, xtol=1e-14)
    ratio = float(np.asarray(found))
    a = 1 / np.sqrt(_area(ratio))
    return ellipsoid((a, a, ratio * a), level=level, degree=degree)


def _area(c: float) -> float:
    """Area over 4π of the spheroid with semi-axes 1, 1, c."""
    if abs(c - 1) < 1e-6:
        return 1 + 2 * (c - 1) / 3
    if c > 1:
        e = np.sqrt(1 - 1 / c**2)
        return 0.5 * (1 + c / e * np.arcsin(e))
    e = np.sqrt(1 - c**2)
    return 0.5 * (1 + (1 - e**2) / e * np.arctanh(e))


def stretched(
    mesh: SurfaceMesh,
    sphere: Float[Array, "nodes 3"],
    size: Float[Array, ""],
    v: float,
    kind: str,
) -> Float[Array, "nodes 3"]:
    """A sphere's nodes on an ellipsoid of a given area and reduced volume.

    - `kind`: `"prolate"`, `"oblate"`, or `"biaxial"` with three axes in geometric progression.
    """
    powers = {"prolate": (0, 0, 1), "oblate": (0, 0, -1), "biaxial": (0, -1, -2)}[kind]

    def nodes(s):
        return sphere * jnp.asarray(np.array([[float(np.exp(s * p)) for p in powers]]))

    s = brentq(lambda s: float(reduced_volume(mesh, nodes(s))) - v, 0.0, 3.0, xtol=1e-8)
    x = nodes(float(np.asarray(s)))
    return x * jnp.sqrt(size / area(mesh, x))

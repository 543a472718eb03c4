"""Start surfaces: spheroids of a given reduced volume."""

import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import brentq

from ..mesh import SurfaceMesh, ellipsoid


def spheroid(
    reduced_volume: float, kind: str = "prolate", level: int = 2, degree: int = 2
) -> tuple[SurfaceMesh, Float[Array, "nodes 3"]]:
    """The spheroid of unit area radius with a given reduced volume: a start for `equilibrium`.

    **Arguments:**

    - `reduced_volume`: between 0.2 and 1, exclusive.
    - `kind`: `"prolate"` (a cigar) or `"oblate"` (a disc).
    - `level`, `degree`: as in `jaxwillmore.mesh.icosphere`.

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

"""Several equilibria at one set of parameters, ranked by energy."""

import math
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh, icosphere
from ..surface import area, reduced_volume, volume
from ._equilibrium import equilibrium
from ._shape import Equilibrium
from ._start import stretched

# Two shapes whose energies and total mean curvatures are this close, on different meshes, are one.
SAME = 2e-3
# Reduced volume of a start that is free, or whose target is not known beforehand.
USUAL = 0.8


def equilibria(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    energy: Any = None,
    *,
    n: int = 4,
    **wanted: Any,
) -> tuple[Equilibrium, ...]:
    r"""Different equilibria at the same parameters, the one of least energy first.

    From the surface itself and, for spheres by topology, from a cigar, a disc and a biaxial
    ellipsoid of the wanted reduced volume on an icosphere with about as many nodes; all of them
    with `search="minimum"`, and with `search="stationary"` where these lead to fewer than `n`.

    **Arguments:**

    - `mesh`, `x`, `energy`, `**wanted`: as of `equilibrium`, without `c`, `search` and `throw`.
      Area and volume are those of this surface where they are held as they are.
    - `n`: at most so many shapes.

    **Returns:** those that converged on a sound mesh, each once, by their total energy.

    **Raises:** `ValueError` as `equilibrium`, and for `n` below 1.

    *Limits:* no list of starts finds all: stomatocytes, pears and shapes with necks need a start of
    their own.

    ```python
    mesh, x = jw.equilibria.spheroid(0.64, level=2)
    found = jw.equilibria.equilibria(mesh, x, reduced_volume=0.64, n=2)  # oblate, then prolate
    ```
    """
    if n < 1:
        raise ValueError(f"`n` must be at least 1; got {n}.")
    # Of the surface that was given, whatever the start.
    if wanted.get("area", "initial") == "initial":
        wanted["area"] = float(area(mesh, x))
    if isinstance(wanted.get("volume"), str):
        wanted["volume"] = float(volume(mesh, x))
    starts = [(mesh, x), *_family(mesh, x, wanted)]
    found: list[Equilibrium] = []
    for search in ("minimum", "stationary"):
        for start in starts:
            shape = equilibrium(*start, energy, search=search, throw=False, **wanted)
            sound = shape.succeeded and shape.health.is_sound
            if sound and not any(_same(shape, other) for other in found):
                found.append(shape)
        if len(found) >= n:
            break
    return tuple(sorted(found, key=lambda shape: float(shape.total_energy))[:n])


def _family(mesh: SurfaceMesh, x, wanted: dict[str, Any]) -> list[tuple[SurfaceMesh, Array]]:
    """Ellipsoids with the area of the surface, on a mesh like its own."""
    if mesh.genus != 0:
        return []
    level = round(math.log(mesh.n_cells / 20, 4))
    sphere, n = icosphere(max(level, 0), mesh.degree)
    v = wanted.get("reduced_volume")
    v = float(reduced_volume(mesh, x)) if v is None else float(v)
    v = v if 0.3 < v < 0.99 else USUAL
    kinds = "prolate", "oblate", "biaxial"
    return [(sphere, stretched(sphere, n, area(mesh, x), v, kind)) for kind in kinds]


def _same(one: Equilibrium, other: Equilibrium) -> bool:
    def numbers(shape):
        values = shape.total_energy, shape.energy, shape.total_mean_curvature
        return np.array([float(value) for value in values])

    a, b = numbers(one), numbers(other)
    return bool(np.all(np.abs(a - b) <= SAME * np.maximum(np.abs(a), np.abs(b))))

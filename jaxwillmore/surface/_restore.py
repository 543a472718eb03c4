r"""A small normal displacement that brings area and volume back to given values."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ._measures import area as area_of, volume as volume_of
from ._recover import recover_mean_curvature, recover_normal

STEPS, ROUNDING = 12, 1e-14
# A larger displacement, over the radius of the sphere of this area, is no correction.
LARGEST = 0.05


def restored(
    mesh: SurfaceMesh,
    x: Float[Array | np.ndarray, "nodes 3"],
    *,
    area: float | None = None,
    volume: float | None = None,
) -> Float[Array, "nodes 3"]:
    r"""The surface moved by $(a + bH)\nu$ to an exact area and volume, as after `mesh.remesh`.

    With one of the two given it moves by $a\nu$.

    **Raises:** `ValueError` where neither is given, where a value is not positive, or where the
    surface would have to move by more than 5 % of its size; on a sphere area and volume cannot
    both be chosen.

    ```python
    new = jw.mesh.remesh(mesh, x)
    x = jw.surface.restored(new.mesh, new.x, area=A, volume=V)
    ```
    """
    given = {"area": area, "volume": volume}
    wanted = {name: float(value) for name, value in given.items() if value is not None}
    if not wanted:
        raise ValueError("Give `area` or `volume`, or both.")
    for name, value in wanted.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"`{name}` must be positive; got {value}.")
    start = jnp.asarray(x)
    targets, names = jnp.array(list(wanted.values())), tuple(wanted)
    R, shift = np.sqrt(float(area_of(mesh, start)) / (4 * np.pi)), jnp.zeros(len(wanted))
    nu, H = _fields(mesh, start)
    ways = jnp.stack([jnp.ones_like(H), H * R][: len(wanted)])
    for _ in range(STEPS):
        missing, slopes = _missing(mesh, start, nu, ways, shift, targets, names)
        if float(jnp.max(jnp.abs(missing))) < ROUNDING:
            break
        change = np.linalg.lstsq(np.asarray(slopes), np.asarray(missing), rcond=1e-9)[0]
        shift = shift - jnp.asarray(change)
        moved = float(jnp.max(jnp.abs(shift @ ways)))
        if not moved < LARGEST * R:
            raise ValueError(
                f"To have {_said(wanted)} the surface would move by {moved:.2g}, more than "
                f"{LARGEST:.0%} of its size: that is another shape."
            )
    missing = _missing(mesh, start, nu, ways, shift, targets, names)[0]
    if not float(jnp.max(jnp.abs(missing))) < 1e-11:
        raise ValueError(
            f"No small displacement gives {_said(wanted)}; on a sphere one follows the other."
        )
    return _displaced(start, nu, ways, shift)


def _said(wanted: dict[str, float]) -> str:
    return " and ".join(f"{name} {value:.6g}" for name, value in wanted.items())


@eqx.filter_jit
def _fields(mesh, x):
    return recover_normal(mesh, x), recover_mean_curvature(mesh, x)


def _displaced(x, nu, ways, shift):
    return x + (shift @ ways)[:, None] * nu


@eqx.filter_jit
def _missing(mesh, x, nu, ways, shift, targets, names):
    """Relative errors of what is wanted, and their derivatives by the displacements."""

    def errors(shift):
        y = _displaced(x, nu, ways, shift)
        found = {"area": area_of, "volume": volume_of}
        return jnp.stack([found[name](mesh, y) for name in names]) / targets - 1

    return errors(shift), jax.jacfwd(errors)(shift)

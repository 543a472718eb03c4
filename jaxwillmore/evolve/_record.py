"""Diagnostics of an accepted step."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import Willmore, willmore_of_field
from ..fem import integrate, integrate_by_cell
from ..flows import AbstractFlow
from ..mesh import SurfaceMesh
from ..surface import area, volume


def corner_angles(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "cells 3"]:
    """Angles of the flat triangles of the vertices, degrees."""
    p = x[mesh.triangles]
    a, b = jnp.roll(p, -1, axis=1) - p, jnp.roll(p, 1, axis=1) - p
    cross = jnp.linalg.norm(jnp.cross(a, b), axis=-1)
    return jnp.degrees(jnp.arctan2(cross, jnp.sum(a * b, axis=-1)))


def alignment(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], nu: Float[Array, "nodes 3"]
) -> Float[Array, " cells"]:
    r"""Mean of $n_\Gamma\cdot\nu_h$ over every cell; negative where a cell has turned over."""

    def density(point, jets):
        return jnp.stack([jnp.sum(point.normal * jets.nu.value), jnp.ones(())])

    sums = integrate_by_cell(mesh, x, density, {"nu": nu})
    return sums[:, 0] / sums[:, 1]


@eqx.filter_jit
def diagnostics(
    flow: AbstractFlow,
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    fields: dict[str, Array],
) -> dict[str, Float[Array, ""]]:
    r"""Energies, measures, angles, and how far the fields are from the geometry of the nodes.

    `normal_length_defect` is $\max ||\nu_h| - 1|$ over the nodes, `normal_distance` the relative
    L² distance of $\nu_h$ from the element normals, `stationarity` is $\max|V|$ divided by the
    velocity scale of the law at the size of the surface. `energy_scale` is the sum of
    the sizes of the terms of the energy, which rises of the energy are relative to.
    """
    nu, H, moment = fields["nu"], fields["H"], flow.with_carried(fields)
    A, volume_ = area(mesh, x), volume(mesh, x)
    distance = integrate(mesh, x, lambda p, f: jnp.sum((f.nu.value - p.normal) ** 2), {"nu": nu})
    angles = corner_angles(mesh, x)
    radius = jnp.sqrt(A / (4 * jnp.pi))
    scale = radius / flow.time_scale(radius)
    return {
        "energy": moment.energy(mesh, x),
        "energy_scale": moment.energy_scale(mesh, x),
        "willmore": Willmore()(mesh, x),
        "willmore_of_field": willmore_of_field(mesh, x, H),
        "area": A,
        "volume": volume_,
        "reduced_volume": 6 * jnp.sqrt(jnp.pi) * volume_ / A**1.5,
        "min_angle": jnp.min(angles),
        "max_angle": jnp.max(angles),
        "normal_length_defect": jnp.max(jnp.abs(jnp.linalg.norm(nu, axis=1) - 1)),
        "normal_distance": jnp.sqrt(distance / A),
        "stationarity": jnp.max(jnp.abs(fields["V"])) / scale,
        "alignment": jnp.min(alignment(mesh, x, nu)),
    }

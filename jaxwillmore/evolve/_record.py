"""Diagnostics of an accepted step."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import Willmore
from ..flows import AbstractLaw, System, Whole, as_system
from ..mesh import SurfaceMesh
from ..surface import area, volume


def corner_angles(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "cells 3"]:
    """Angles of the flat triangles of the vertices, degrees."""
    p = x[mesh.triangles]
    a, b = jnp.roll(p, -1, axis=1) - p, jnp.roll(p, 1, axis=1) - p
    cross = jnp.linalg.norm(jnp.cross(a, b), axis=-1)
    return jnp.degrees(jnp.arctan2(cross, jnp.sum(a * b, axis=-1)))


def diagnostics(
    flow: System | AbstractLaw,
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    fields: dict[str, Array],
    multipliers: Float[Array, " globals"] | None = None,
) -> dict[str, Float[Array, ""] | float]:
    r"""Energies, measures and angles, and what the laws record of their fields.

    `stationarity` is the largest activity of the laws: $\max|V|$ divided by the velocity scale of
    the law at the size of the surface, or the flux of a concentration by its scale. `energy_scale`
    is the sum of the sizes of the terms of the energy, which rises of the energy are relative to.
    `alignment` is below zero where a cell has turned over against the normal field.

    What depends on fields or multipliers that are not given, as none are for `V` and `z` before the
    first step, is `nan`.
    """
    flow = as_system(flow)
    unknown = [field for field in flow.fields if field.name not in fields]
    if not unknown and (multipliers is not None or not flow.n_globals):
        given = jnp.zeros(0) if multipliers is None else multipliers
        return dict(_diagnostics(flow, mesh, x, fields, given))
    # What depends on them changes with them. Not a constant, of which gradients would be zero.
    one, other = (
        _diagnostics(
            flow,
            mesh,
            x,
            fields | _made_up(unknown, x, size),
            jnp.full(flow.n_globals, size) if multipliers is None else multipliers,
        )
        for size in (0.0, 1.0)
    )
    return {name: one[name] if one[name] == other[name] else math.nan for name in one}


def _made_up(unknown, x: Float[Array, "nodes 3"], size: float) -> dict[str, Array]:
    """Values of fields in place of those that nobody knows."""
    shape = size * (1.0 + x[:, :1])
    return {
        field.name: shape[:, 0] if field.components == 1 else jnp.tile(shape, field.components)
        for field in unknown
    }


@eqx.filter_jit
def _diagnostics(flow: System, mesh, x, fields, multipliers) -> dict[str, Float[Array, ""]]:
    A, volume_ = area(mesh, x), volume(mesh, x)
    units = flow.units(jnp.sqrt(A / (4 * jnp.pi)))
    whole = Whole(jnp.zeros(()), mesh, x, fields, flow.named(multipliers), units)
    angles = corner_angles(mesh, x)
    return {
        "energy": flow.energy(mesh, x, fields),
        "energy_scale": flow.energy_scale(mesh, x, fields),
        "willmore": Willmore()(mesh, x),
        "area": A,
        "volume": volume_,
        "reduced_volume": 6 * jnp.sqrt(jnp.pi) * volume_ / A**1.5,
        "min_angle": jnp.min(angles),
        "max_angle": jnp.max(angles),
        "stationarity": flow.activity(whole),
        **flow.record(whole),
    }

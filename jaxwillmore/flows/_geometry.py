r"""What laws of a surface share: its normal and mean curvature, their start, their record."""

import equinox as eqx
import jax.numpy as jnp

from ..energies import willmore_of_field
from ..fem import integrate, integrate_by_cell
from ..surface import (
    area,
    nodal_weingarten_squared,
    recover_mean_curvature,
    recover_normal,
)
from ._law import Field, Whole


def normal_motion(nodal):
    r"""(10e)  $v = V\nu$, node by node."""
    return nodal.V * nodal.nu


def recovered_geometry(mesh, x, given):
    """H and ν at the start: as given, or recovered from the nodes."""
    if "H" in given and "nu" in given:
        return {"H": given["H"], "nu": given["nu"]}
    return _recovered(mesh, x) | {name: given[name] for name in ("H", "nu") if name in given}


@eqx.filter_jit
def _recovered(mesh, x):
    return {"H": recover_mean_curvature(mesh, x), "nu": recover_normal(mesh, x)}


def geometric_fields(H, V, nu, length_time) -> tuple[Field, Field, Field]:
    """H, V and ν with their equations; a surface of size R moves by R in `length_time(R)`."""
    return (
        Field("H", H, lambda u: 1 / u.length, role="geometric"),
        Field("V", V, lambda u: u.length / length_time(u.length)),
        Field("nu", nu, lambda u: jnp.ones(()), role="geometric", components=3),
    )


def speed_at_rest(length_time):
    r"""$\max|V|$ over the velocity $R/T(R)$ of the law, as a function of the surface."""

    def activity(s: Whole):
        return jnp.max(jnp.abs(s.fields["V"])) / (s.units.length / length_time(s.units.length))

    return activity


def geometry_record(s: Whole):
    r"""How far the fields are from the geometry of the nodes.

    `normal_length_defect` is $\max||\nu_h| - 1|$ over the nodes, `normal_distance` the relative L²
    distance of $\nu_h$ from the element normals, `alignment` the least mean of $n_\Gamma\cdot\nu_h$
    over a cell, negative where a cell has turned over, `max_curvature` the largest $|A|$ at a node.
    """
    nu, H = s.fields["nu"], s.fields["H"]
    density = lambda p, f: jnp.sum((f.nu.value - p.normal) ** 2)
    distance = integrate(s.mesh, s.x, density, {"nu": nu})
    return {
        "willmore_of_field": willmore_of_field(s.mesh, s.x, H),
        "normal_length_defect": jnp.max(jnp.abs(jnp.linalg.norm(nu, axis=1) - 1)),
        "normal_distance": jnp.sqrt(distance / area(s.mesh, s.x)),
        "max_curvature": jnp.sqrt(jnp.max(nodal_weingarten_squared(s.mesh, s.x, nu))),
        "alignment": jnp.min(alignment(s.mesh, s.x, nu)),
    }


def alignment(mesh, x, nu):
    r"""Mean of $n_\Gamma\cdot\nu_h$ over every cell; negative where a cell has turned over."""

    def density(point, jets):
        return jnp.stack([jnp.sum(point.normal * jets.nu.value), jnp.ones(())])

    sums = integrate_by_cell(mesh, x, density, {"nu": nu})
    return sums[:, 0] / sums[:, 1]

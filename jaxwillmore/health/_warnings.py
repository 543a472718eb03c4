"""One function that looks at a surface and says, by name, what makes it no evidence."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..energies import Willmore, willmore_of_field
from ..equilibria import MAX_OFFSET, MIN_ANGLE, mesh_health
from ..mesh import SurfaceMesh, check_mesh
from ._energy_error import energy_error, least_willmore

# Beyond this estimated error the energy of a mesh says nothing.
UNRESOLVED = 0.2
# A mesh that needs a larger allowance than this below the bound is not resolved anyway.
LARGEST_ALLOWANCE = 0.1
# Area elements that vary more than this within a triangle tell that it is about to fold.
MIN_JACOBIAN = 0.2
REMESH = (
    "Remesh: `remesh_when = 15` in [mesh], `evolve(..., remesh=Remeshing())` in Python, or "
    "`jw.mesh.remesh`."
)
# Relative distance of the two energies that time stepping alone may leave.
APART = 0.01

# Compiled once: a run with fatal warnings asks after every step.
_willmore = eqx.filter_jit(Willmore())
_willmore_of_field = eqx.filter_jit(willmore_of_field)


@dataclasses.dataclass(frozen=True)
class HealthWarning:
    """What is wrong, how much, and how much would be all right."""

    kind: str
    """One of `not_finite`, `energy_below_bound`, `field_energy_below_bound`, `energies_apart`,
    `unresolved_curvature`, `small_angle`, `mid_node_offset`, `collapsed_element`,
    `self_intersection`; of a concentration `unresolved_interface`, `concentration_outside`,
    `amount_drift`, `negative_modulus`."""
    value: float
    limit: float
    message: str


def health_warnings(
    mesh: SurfaceMesh,
    x: Float[Array | np.ndarray, "nodes 3"],
    H: Float[Array | np.ndarray, " nodes"] | None = None,
    *,
    self_intersection: bool = False,
) -> tuple[HealthWarning, ...]:
    r"""Reasons not to believe a shape or its energy; none is a good sign.

    Meshes can lower a discrete energy by collapsing. $\tfrac12\int H^2$ of a smooth closed surface
    is at least 8π, with handles 4π²; less than that by more than the discretisation error
    (`energy_error`, at most 10 %) is an artefact. The energies of the nodes and of a mean curvature
    field that was computed beside them may differ by 1 % plus that error.

    **Arguments:**

    - `H`: a mean curvature field, if there is one.
    - `self_intersection`: also look for triangles that pierce each other (the slowest check).
    """
    nodes = np.asarray(x)
    if not np.all(np.isfinite(nodes)):
        count = float(np.count_nonzero(~np.all(np.isfinite(nodes), axis=1)))
        return (HealthWarning("not_finite", count, 0.0, "Nodes are not finite."),)
    field = None if H is None else jnp.asarray(H)
    found = [*_energy(mesh, jnp.asarray(nodes), field), *_elements(mesh, nodes)]
    if self_intersection:
        found += _piercing(mesh, nodes)
    return tuple(found)


def _energy(mesh, x, H) -> list[HealthWarning]:
    error, bound = energy_error(mesh, x), least_willmore(mesh.genus)
    name = "8π" if mesh.genus == 0 else "4π²"
    limit = bound * (1 - min(error, LARGEST_ALLOWANCE))
    energy = float(_willmore(mesh, x))
    found = []
    if not energy >= limit:
        text = (
            f"½∫H² of the nodes is {energy:.5g}, below {name} = {bound:.5g}, the least of all "
            "surfaces, by more than the discretisation error: the mesh has collapsed."
        )
        found.append(HealthWarning("energy_below_bound", energy, limit, text))
    if not error <= UNRESOLVED:
        text = (
            f"Triangles are large against the radii of curvature: ½∫H² may be off by {error:.0%}. "
            "Refine the mesh or raise its degree."
        )
        found.append(HealthWarning("unresolved_curvature", error, UNRESOLVED, text))
    if H is None:
        return found
    of_field = float(_willmore_of_field(mesh, x, H))
    if not of_field >= limit:
        text = (
            f"½∫H² of the field H is {of_field:.5g}, below {name} = {bound:.5g}: the field has "
            "left the surface it lives on."
        )
        found.append(HealthWarning("field_energy_below_bound", of_field, limit, text))
    apart = abs(of_field / energy - 1) if energy > 0 else math.inf
    allowed = APART + min(error, LARGEST_ALLOWANCE)
    if not apart <= allowed:
        text = (
            f"½∫H² is {energy:.5g} from the nodes and {of_field:.5g} from the field H: the field "
            "does not belong to the surface."
        )
        found.append(HealthWarning("energies_apart", apart, allowed, text))
    return found


def _elements(mesh, x) -> list[HealthWarning]:
    health = mesh_health(mesh, x)
    found = []
    if not health.min_angle > MIN_ANGLE:
        text = f"A triangle has an angle of {health.min_angle:.2g}°. {REMESH}"
        found.append(HealthWarning("small_angle", health.min_angle, MIN_ANGLE, text))
    if not health.mid_node_offset < MAX_OFFSET:
        text = (
            f"A node inside an edge is displaced along it by {health.mid_node_offset:.2g} of its "
            f"length. {REMESH}"
        )
        found.append(HealthWarning("mid_node_offset", health.mid_node_offset, MAX_OFFSET, text))
    if not health.min_jacobian > MIN_JACOBIAN:
        text = (
            f"The area element of a curved triangle falls to {health.min_jacobian:.2g} of its "
            f"mean: the triangle is folded, or on the way to it. {REMESH}"
        )
        found.append(HealthWarning("collapsed_element", health.min_jacobian, MIN_JACOBIAN, text))
    return found


def _piercing(mesh, x) -> list[HealthWarning]:
    report = check_mesh(mesh, x)
    count = sum(f.count for f in report.findings if f.kind == "self_intersections")
    if not count:
        return []
    text = f"{count} triangles pierce each other: the surface passes through itself."
    return [HealthWarning("self_intersection", float(count), 0.0, text)]

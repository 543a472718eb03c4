"""Surfaces with a formula: every node lies on the exact surface to rounding error.

Each generator returns `(mesh, x)`. Sphere-like surfaces are images of an icosphere with
10·4^level + 2 vertices, five-fold about z; torus-like ones are images of a grid of nearly
equilateral triangles.
The nodes are images of equispaced points, so cells of degree k approximate at their full order.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._types import Nodes
from ..reference import lagrange_basis, lagrange_nodes
from ._adjacency import lagrange_cells, scatter, split_triangles
from ._surface_mesh import SurfaceMesh

_MAX_LEVEL = 10

Real = float | int | Float[Array, ""]  # a size may be traced, to differentiate by it


def from_sphere_map(
    f: Callable[[Float[Array, "3"]], Float[Array, "3"]], level: int = 2, degree: int = 2
) -> tuple[SurfaceMesh, Nodes]:
    """The image of the unit sphere under a smooth map.

    The mesh of the sphere is symmetric by turns of 72° about the z axis, two of its vertices lie on
    it: let the axis of a body of revolution be the image of z, and its mesh will not favour a mode
    cos mφ unless m is a multiple of 5.

    **Arguments:**

    - `f`: takes one unit vector to one point; one-to-one, orientation preserving, built of JAX
      operations. For full order it must be smooth *on the sphere*: use the unit vector itself
      rather than its angles.
    - `level`: the icosphere has 10·4^level + 2 vertices.
    - `degree`: polynomial degree of the triangles.

    **Raises:** `ValueError` if `level` or `degree` is out of range, if a point is not finite, or
    if the enclosed volume is not positive.

    ```python
    mesh, x = jw.mesh.from_sphere_map(lambda n: n * (1.0 + 0.1 * n[2] ** 3), level=2)
    ```
    """
    triangles, vertices = _icosahedral_sphere(level)
    cells, n_nodes = lagrange_cells(triangles, len(vertices), degree)
    nodes = scatter(cells, n_nodes, _affine(vertices[triangles], degree))
    nodes /= np.linalg.norm(nodes, axis=1, keepdims=True)
    x = jax.vmap(f)(jnp.asarray(nodes))
    return _outward(SurfaceMesh(cells, degree, n_nodes), x)


def from_torus_map(
    f: Callable[[Float[Array, ""], Float[Array, ""]], Float[Array, "3"]],
    n_major: int,
    n_minor: int,
    degree: int = 2,
) -> tuple[SurfaceMesh, Nodes]:
    """The image of the square of two angles under a doubly periodic map.

    The `2 · n_major · n_minor` triangles are images of triangles in the plane of the angles. For
    even `n_major` every second ring is shifted by half a step, which makes them nearly equilateral
    and the mesh symmetric; otherwise each rectangle is cut along the same diagonal.

    **Arguments:**

    - `f`: takes (θ, φ) to a point; 2π-periodic in both, `∂f/∂θ × ∂f/∂φ` points outward.
    - `n_major`, `n_minor`: number of steps in θ and in φ, at least 3 each.
    - `degree`: polynomial degree of the triangles.

    **Raises:** as `from_sphere_map`.
    """
    triangles, angles = _angle_grid(_count("n_major", n_major), _count("n_minor", n_minor))
    cells, n_nodes = lagrange_cells(triangles, n_major * n_minor, degree)
    nodes = scatter(cells, n_nodes, _affine(angles, degree))
    x = jax.vmap(f)(jnp.asarray(nodes[:, 0]), jnp.asarray(nodes[:, 1]))
    return _outward(SurfaceMesh(cells, degree, n_nodes), x)


def icosphere(level: int = 2, degree: int = 2, radius: Real = 1.0) -> tuple[SurfaceMesh, Nodes]:
    """A sphere of the given `radius` about the origin; see `from_sphere_map`."""
    _check_positive(radius=radius)
    return from_sphere_map(lambda n: radius * n, level, degree)


def ellipsoid(
    semi_axes=(1.0, 1.0, 2.0), level: int = 2, degree: int = 2
) -> tuple[SurfaceMesh, Nodes]:
    """The ellipsoid x²/a² + y²/b² + z²/c² = 1 with `semi_axes` (a, b, c); see `from_sphere_map`."""
    if np.shape(semi_axes) != (3,):
        raise ValueError(f"`semi_axes` must be three lengths; got {semi_axes!r}.")
    for axis in semi_axes:
        _check_positive(semi_axes=axis)
    axes = jnp.asarray(semi_axes, dtype=jnp.float64)
    return from_sphere_map(lambda n: axes * n, level, degree)


def red_cell(
    level: int = 2,
    degree: int = 2,
    radius: Real = 2.0,
    thickness: Real = 1.0,
    dimple: Real = 0.7,
) -> tuple[SurfaceMesh, Nodes]:
    """A biconcave disc: distance from the axis and height as functions of the latitude φ are

    ρ = radius · cos φ,  z = thickness · (1 − dimple · (cos²φ − 1)²) · sin φ.

    The defaults give ½∫H² = 46.148735, area 33.25708682 and volume 11.72861257. The thickness at
    the centre is 2 · thickness · (1 − dimple), so `dimple` must be below 1. See `from_sphere_map`.
    """
    _check_positive(radius=radius, thickness=thickness)
    _check_range("dimple", dimple, -1.0, 1.0)

    def point(n):
        height = thickness * (1.0 - dimple * n[2] ** 4) * n[2]
        return jnp.stack([radius * n[0], radius * n[1], height])

    return from_sphere_map(point, level, degree)


def evans_fung(
    level: int = 2,
    degree: int = 2,
    radius: Real = 3.91,
    c0: Real = 0.81,
    c2: Real = 7.83,
    c4: Real = -4.39,
) -> tuple[SurfaceMesh, Nodes]:
    """The resting human red blood cell of Evans and Fung, in micrometres:

    z(ρ) = ±½ √(1 − q) · (c0 + c2 q + c4 q²),  q = ρ²/radius².

    The defaults give ½∫H² = 48.4745, area 134.090 µm², volume 94.091 µm³. See `from_sphere_map`.

    ??? cite "Reference"
        Evans, Fung (1972), *Microvasc. Res.* 4, 335–347.
    """
    _check_positive(radius=radius)
    for name, value in (("c0", c0), ("c2", c2), ("c4", c4)):
        _number(name, value)
    q = np.linspace(0.0, 1.0, 201)
    if not _is_traced(c0, c2, c4) and np.min(c0 + c2 * q + c4 * q**2) <= 0:
        raise ValueError(
            f"The profile c0 + c2 q + c4 q² must be positive for q in [0, 1]; got c0 = {c0}, "
            f"c2 = {c2}, c4 = {c4}."
        )

    def point(n):
        q = n[0] ** 2 + n[1] ** 2
        height = 0.5 * n[2] * (c0 + c2 * q + c4 * q**2)
        return jnp.stack([radius * n[0], radius * n[1], height])

    return from_sphere_map(point, level, degree)


def dumbbell(
    level: int = 2, degree: int = 2, neck: Real = 0.4, lobe: Real = 0.6
) -> tuple[SurfaceMesh, Nodes]:
    """A body of revolution about the x axis with two lobes, for φ in [0, π]:

    x = cos φ,  ρ = (lobe · cos²φ + neck) · sin φ.

    The defaults give ½∫H² = 38.30406844, area 6.33729845, volume 1.20158439; `neck` is the radius
    in the middle. See `from_sphere_map`.
    """
    _check_positive(neck=neck)
    _number("lobe", lobe)
    if not _is_traced(lobe, neck) and not lobe + neck > 0:
        raise ValueError(f"`lobe` + `neck` must be positive; got {lobe} + {neck}.")

    def point(n):
        width = lobe * n[2] ** 2 + neck
        return jnp.stack([n[2], width * n[0], width * n[1]])

    return from_sphere_map(point, level, degree)


def torus(
    major_radius: Real = 1.0,
    minor_radius: Real = 0.4,
    n_major: int | None = None,
    n_minor: int | None = None,
    level: int = 2,
    degree: int = 2,
) -> tuple[SurfaceMesh, Nodes]:
    """A torus of revolution about the z axis: a circle of `minor_radius` at `major_radius`.

    Where `n_minor` is not given it is 3·2^level; where `n_major` is not given it is the even
    number that makes the triangles nearest to equilateral. `major_radius = √2 · minor_radius` is
    the Clifford torus, ½∫H² = 4π². See `from_torus_map`.

    **Raises:** `ValueError` unless 0 < `minor_radius` < `major_radius`.
    """
    _check_positive(major_radius=major_radius, minor_radius=minor_radius)
    if not _is_traced(major_radius, minor_radius) and not minor_radius < major_radius:
        raise ValueError(
            f"`minor_radius` must be below `major_radius`; got {minor_radius} and {major_radius}."
        )
    return beads_torus(major_radius, minor_radius, 0.0, 0, n_major, n_minor, level, degree)


def beads_torus(
    major_radius: Real = 1.0,
    minor_radius: Real = 0.4,
    amplitude: Real = 0.1,
    n_beads: int = 6,
    n_major: int | None = None,
    n_minor: int | None = None,
    level: int = 2,
    degree: int = 2,
) -> tuple[SurfaceMesh, Nodes]:
    """A torus whose minor radius `minor_radius + amplitude · sin(n_beads · θ)` swells and shrinks.

    The defaults give ½∫H² = 114.957175. Counts of triangles as in `torus`, with at least four
    rings per bead.

    **Raises:** `ValueError` unless 0 < `minor_radius` ± `amplitude` < `major_radius`.
    """
    _check_positive(major_radius=major_radius, minor_radius=minor_radius)
    _number("amplitude", amplitude)
    if isinstance(n_beads, bool) or not isinstance(n_beads, int) or n_beads < 0:
        raise ValueError(f"`n_beads` must be an integer of at least 0; got {n_beads!r}.")
    if not _is_traced(major_radius, minor_radius, amplitude) and not (
        abs(amplitude) < minor_radius and minor_radius + abs(amplitude) < major_radius
    ):
        raise ValueError(
            "A torus needs |amplitude| < minor_radius and minor_radius + |amplitude| < "
            f"major_radius; got minor_radius = {minor_radius}, amplitude = {amplitude}, "
            f"major_radius = {major_radius}."
        )
    if n_minor is None:
        _check_level(level)
        n_minor = 3 * (1 << level)
    n_minor = _count("n_minor", n_minor)
    if n_major is None:
        # Equilateral triangles are √3/2 of their base high; rings come in pairs.
        ideal = n_minor * float(major_radius) / float(minor_radius) * 2 / np.sqrt(3)
        n_major = max(4, 4 * n_beads, 2 * round(ideal / 2))

    def point(theta, phi):
        r = minor_radius + amplitude * jnp.sin(n_beads * theta)
        rho = major_radius + r * jnp.cos(phi)
        return jnp.stack([rho * jnp.cos(theta), rho * jnp.sin(theta), r * jnp.sin(phi)])

    return from_torus_map(point, n_major, n_minor, degree)


def _icosahedral_sphere(level: int):
    """Triangles and unit vertices of an icosahedron subdivided `level` times, two of them on z.

    The discretisation error has the symmetry of the mesh. Five-fold about z, it is orthogonal to
    the modes cos 2φ, sin 2φ by which discs become unstable, and does not push a body of revolution
    off its family; a two-fold axis of the icosahedron on z would.
    """
    _check_level(level)
    turn = 2 * np.pi / 5 * np.arange(5)
    upper = np.stack([2 * np.sin(turn), 2 * np.cos(turn), np.ones(5)], axis=1)
    pole = np.array([[0.0, 0.0, np.sqrt(5)]])
    vertices = np.concatenate([pole, upper, -upper, -pole]) / np.sqrt(5)
    # The faces are the triples of nearest neighbours, turned so that they are seen from outside.
    edge = np.sqrt(2 - 2 / np.sqrt(5))
    near = np.isclose(np.linalg.norm(vertices[:, None] - vertices, axis=-1), edge)
    triangles = np.array(
        [
            (i, j, k) if np.linalg.det(vertices[[i, j, k]]) > 0 else (i, k, j)
            for i in range(12)
            for j in range(i + 1, 12)
            for k in range(j + 1, 12)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    for _ in range(level):
        triangles, edges = split_triangles(triangles, len(vertices))
        middle = vertices[edges.vertices].sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        vertices = np.concatenate([vertices, middle])
    return triangles, vertices


def _angle_grid(n_major: int, n_minor: int):
    """Triangles of a torus and, per triangle, the unwrapped angles (θ, φ) of its corners."""
    ring, step = np.divmod(np.arange(n_major * n_minor), n_minor)
    shifted = (ring % 2) * (n_major % 2 == 0)
    # Corners as (ring, step) beside a corner at (0, 0); the first triangle of each pair has its
    # base on this ring, the second on the next one. A shifted ring leans the other way.
    straight = np.array([[(0, 0), (1, 0), (0, 1)], [(0, 1), (1, 0), (1, 1)]])
    leaning = np.array([[(0, 0), (1, 1), (0, 1)], [(0, 0), (1, 0), (1, 1)]])
    offset = np.where(shifted[:, None, None, None], leaning, straight)
    corner_ring = ring[:, None, None] + offset[..., 0]
    corner_step = step[:, None, None] + offset[..., 1]
    triangles = (corner_ring % n_major) * n_minor + corner_step % n_minor
    shift = 0.5 * (corner_ring % 2) * (n_major % 2 == 0)
    theta = 2 * np.pi / n_major * corner_ring
    phi = 2 * np.pi / n_minor * (corner_step + shift)
    angles = np.stack([theta, phi], axis=-1)
    return triangles.reshape(-1, 3), angles.reshape(-1, 3, 2)


def _affine(corners: Float[np.ndarray, "cells 3 d"], degree: int):
    """The equispaced points of flat triangles with these corners."""
    return np.einsum("lc,tcd->tld", lagrange_basis(1, lagrange_nodes(degree)), corners)


def _is_traced(*values) -> bool:
    return any(isinstance(value, Tracer) for value in values)


def _outward(mesh: SurfaceMesh, x: Float[Array, "..."]) -> tuple[SurfaceMesh, Nodes]:
    """Return the surface, or complain when the map behind it was not what it must be."""
    if _is_traced(x):
        return mesh, x
    points = np.asarray(x)
    if points.shape != (mesh.n_nodes, 3):
        raise ValueError(f"The map must return points of shape (3,); got {points.shape[1:]}.")
    if not np.all(np.isfinite(points)):
        raise ValueError("The map returned a point that is not finite.")
    volume = np.linalg.det(points[np.asarray(mesh.triangles)]).sum() / 6
    if not volume > 0:
        raise ValueError(
            f"The surface encloses the volume {volume:.3g}, so its normals point inward. "
            "The map must preserve orientation."
        )
    return mesh, x


def _check_level(level: int) -> None:
    if isinstance(level, bool) or not isinstance(level, int) or not 0 <= level <= _MAX_LEVEL:
        raise ValueError(f"`level` must be an integer from 0 to {_MAX_LEVEL}; got {level!r}.")


def _count(name: str, count: int) -> int:
    if isinstance(count, bool) or not isinstance(count, int) or count < 3:
        raise ValueError(f"`{name}` must be an integer of at least 3; got {count!r}.")
    return count


def _number(name: str, value) -> None:
    """Raise unless `value` is a finite real number, an array of them, or traced."""
    if not _is_traced(value):
        array = np.asarray(value)
        if array.dtype.kind not in "iuf" or not np.all(np.isfinite(array)):
            raise ValueError(f"`{name}` must be a finite number; got {value!r}.")


def _check_positive(**values) -> None:
    for name, value in values.items():
        _number(name, value)
        if not _is_traced(value) and not np.all(np.asarray(value) > 0):
            raise ValueError(f"`{name}` must be positive; got {value}.")


def _check_range(name: str, value: Real, low: float, high: float) -> None:
    _number(name, value)
    if not _is_traced(value) and not low < value < high:
        raise ValueError(f"`{name}` must lie between {low} and {high}; got {value}.")

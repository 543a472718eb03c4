r"""Autodiff of the discrete energies against the formulas of the smooth ones, as h falls.

Two independent answers stand beside the derivative of the discrete energy: the formula with the
exact surface (spectral quadrature, curvatures by differentiation of the level set), and the same
formula with the normals and curvatures that are recovered from the nodes.
"""

import functools as ft
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import (
    AbstractEnergy,
    AreaDifference,
    CanhamHelfrich,
    GinzburgLandau,
    Mixture,
    OsmoticPressure,
    Pressure,
    SurfaceTension,
    TwoPhase,
    Willmore,
    shape_derivative,
)
from ..fem import Jet, integrate
from ..mesh import SurfaceMesh
from ..surface import (
    area,
    recover_mean_curvature,
    recover_normal,
    volume,
    weingarten,
)
from ._exact_surface import ExactSurface, bumpy_surface, round_torus, triaxial_ellipsoid
from ._first_variation import Geometry, Whole, concentration_variation, first_variation
from ._orders import with_orders

SURFACES = (triaxial_ellipsoid, round_torus, bumpy_surface)
# In the order of the table; compiled functions return dictionaries sorted by name.
STUDIED: dict[str, AbstractEnergy] = {
    "Willmore": Willmore(),
    "Canham-Helfrich": CanhamHelfrich(0.6, 0.2, 0.7),
    "tension": SurfaceTension(0.8),
    "pressure": Pressure(0.9),
    "osmotic": OsmoticPressure(6.0, 3.0, 1.0, 0.5),
    "area difference": AreaDifference(1.2, 0.3, 0.1),
    "Ginzburg-Landau": GinzburgLandau(0.3, 0.6),
    "two phases": TwoPhase(Mixture(0.5, 0.8), Mixture(-0.2, 0.9), Mixture(0.2, -0.4), 0.3, 0.6),
}
ENERGIES = tuple(STUDIED)
OF_A_CONCENTRATION = ("Ginzburg-Landau", "two phases")
DIRECTIONS = ("normal", "tangential", "concentration")
Row = dict[str, Any]


def normal_speed(p: Float[Array, "3"]) -> Float[Array, ""]:
    """V of the normal direction: smooth, without symmetry."""
    return 1.0 + 0.5 * p[0] - 0.3 * p[1] * p[2] + p[2] ** 2


def carried_field(p: Float[Array, "3"]) -> Float[Array, ""]:
    """The concentration, carried by the nodes."""
    return 0.5 + 0.4 * jnp.sin(1.5 * p[0] + p[1]) - 0.2 * p[2]


def tangential_velocity(nu: Float[Array, "3"], p: Float[Array, "3"]) -> Float[Array, "3"]:
    """T of the tangential direction: no symmetry of the test surfaces makes its work vanish."""
    w = jnp.stack([p[0] + p[1] ** 2, 0.5 * p[2] - 0.4 * p[1], 0.7 * p[2] + p[0] * p[1]])
    return w - jnp.dot(w, nu) * nu


def change_of_the_field(p: Float[Array, "3"]) -> Float[Array, ""]:
    """The direction in which the concentration is changed."""
    return jnp.cos(p[0]) - 0.4 * p[1] + 0.6 * p[2] * p[0]


@eqx.filter_jit
def exact_derivatives(surface: ExactSurface) -> dict[str, Float[Array, "directions 2"]]:
    r"""Derivative of every energy in every direction, and the size that errors are relative to.

    The size is $\int |gV| + |q\cdot\nabla V|$, and $\int |\mu\psi|$ by the concentration.
    """
    p, weights = surface.points()
    level_set = surface.level_set
    nu, H = level_set.normal(p), level_set.mean_curvature(p)
    whole = Whole(
        jnp.sum(weights),
        jnp.sum(weights * jnp.sum(p * nu, axis=1)) / 3,
        jnp.sum(weights * H),
    )

    def carried_away(p):
        """-T·∇c: how c at a fixed place changes when T carries it."""
        T = tangential_velocity(level_set.normal(p[None])[0], p)
        return -jnp.dot(T, jax.grad(carried_field)(p))

    def at(p):
        H = Jet(level_set.mean_curvature(p[None])[0], level_set.mean_curvature_gradient(p[None])[0])
        c, V = surface.jet(carried_field, p), surface.jet(normal_speed, p)
        here = Geometry(H, level_set.weingarten(p[None])[0], c)
        carried, changed = (surface.jet(f, p) for f in (carried_away, change_of_the_field))
        out = []
        for energy in STUDIED.values():
            g, q = first_variation(energy, here, whole)
            terms = jnp.stack([g * V.value, jnp.dot(q, V.grad)])
            size = jnp.sum(jnp.abs(terms))
            along = concentration_variation(energy, here, carried)
            by_c = concentration_variation(energy, here, changed)
            answers = (jnp.sum(terms), size), (along, size), (by_c, jnp.abs(by_c))
            out.append(jnp.stack([jnp.stack(answer) for answer in answers]))
        return jnp.stack(out)

    values = jnp.tensordot(weights, jax.vmap(at)(p), axes=1)
    return dict(zip(ENERGIES, values, strict=True))


@eqx.filter_jit
def discrete_derivatives(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    normal: Float[Array, "nodes 3"],
) -> dict[str, Float[Array, " directions"]]:
    """Derivatives of the discrete energies by JAX, in the three directions."""
    V, c = jax.vmap(normal_speed)(x), jax.vmap(carried_field)(x)
    T = jax.vmap(tangential_velocity)(normal, x)

    def all_of(mesh, x, c):
        return jnp.stack([energy(mesh, x, {"c": c}) for energy in STUDIED.values()])

    def with_c(mesh, x):
        return all_of(mesh, x, c)

    directions = jnp.stack([V[:, None] * normal, T])
    by_shape = jax.vmap(ft.partial(shape_derivative, with_c, mesh, x))(directions)
    psi = jax.vmap(change_of_the_field)(x)
    _, by_c = jax.jvp(ft.partial(all_of, mesh, x), (c,), (psi,))
    slopes = jnp.concatenate([by_shape, by_c[None]])
    return {name: slopes[:, k] for k, name in enumerate(ENERGIES)}


@eqx.filter_jit
def recovered_derivatives(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"]
) -> dict[str, Float[Array, ""]]:
    """The formulas in the normal direction with what is recovered from the nodes."""
    nu, H = recover_normal(mesh, x), recover_mean_curvature(mesh, x)
    fields = {
        "H": H,
        "nu": nu,
        "c": jax.vmap(carried_field)(x),
        "V": jax.vmap(normal_speed)(x),
    }
    total = integrate(mesh, x, lambda _, f: f.H.value, fields)
    whole = Whole(area(mesh, x), volume(mesh, x), total)

    def density(_, f):
        here = Geometry(f.H, weingarten(f.nu), f.c)
        variations = [first_variation(energy, here, whole) for energy in STUDIED.values()]
        return jnp.stack([g * f.V.value + jnp.dot(q, f.V.grad) for g, q in variations])

    values = integrate(mesh, x, density, fields)
    return {name: values[k] for k, name in enumerate(ENERGIES)}


def shape_derivative_rows(
    surface: ExactSurface, levels: Sequence[int] = (1, 2, 3), degree: int = 2
) -> list[Row]:
    r"""The study of one surface as a table: one row per energy, direction and mesh.

    Columns: `surface`, `energy`, `direction`, `nodes`, `h`, the derivative `autodiff` of the
    discrete energy, `exact`, the `error` between them, `recovered` and its `recovered_error` (only
    in the normal direction), and the orders observed from the row before. Errors are relative to
    $\int |gV| + |q\cdot\nabla V|$, which stays away from zero when the derivative does not; in the
    direction `concentration`, which only energies of two phases have, to $\int |\mu\psi|$. The
    tangential derivative of all others is exactly zero.
    """
    exact = exact_derivatives(surface)
    found = []
    for level in levels:
        mesh, x = surface.generate(level, degree)
        normal = surface.level_set.normal(x)
        h = float(jnp.sqrt(area(mesh, x) / mesh.n_cells * 4 / jnp.sqrt(3.0)))
        slopes = discrete_derivatives(mesh, x, normal), recovered_derivatives(mesh, x)
        found.append(({"nodes": mesh.n_nodes, "h": h}, *slopes))
    rows: list[Row] = []
    for name in ENERGIES:
        directions = DIRECTIONS if name in OF_A_CONCENTRATION else DIRECTIONS[:2]
        for k, direction in enumerate(directions):
            answer, scale = exact[name][k]
            own = []
            for numbers, autodiff, recovered in found:
                row = {"surface": surface.name, "energy": name, "direction": direction} | numbers
                row |= {"autodiff": float(autodiff[name][k]), "exact": float(answer)}
                row["error"] = abs(row["autodiff"] - row["exact"]) / float(scale)
                if k == 0:
                    row["recovered"] = float(recovered[name])
                    difference = abs(row["recovered"] - row["exact"])
                    row["recovered_error"] = difference / float(scale)
                own.append(row)
            errors = ("error", "recovered_error") if k == 0 else ("error",)
            rows += with_orders(own, "h", errors)
    return rows

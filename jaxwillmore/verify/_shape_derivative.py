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
    OsmoticPressure,
    Pressure,
    SurfaceTension,
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
from ._first_variation import CarriedLineEnergy, Geometry, Whole, first_variation
from ._orders import with_orders

SURFACES = (triaxial_ellipsoid, round_torus, bumpy_surface)
# In the order of the table; compiled functions return dictionaries sorted by name.
ENERGIES = (
    "Willmore",
    "Canham-Helfrich",
    "tension",
    "pressure",
    "osmotic",
    "area difference",
    "line energy",
)
DIRECTIONS = ("normal", "tangential")
Row = dict[str, Any]


def normal_speed(p: Float[Array, "3"]) -> Float[Array, ""]:
    """V of the normal direction: smooth, without symmetry."""
    return 1.0 + 0.5 * p[0] - 0.3 * p[1] * p[2] + p[2] ** 2


def carried_field(p: Float[Array, "3"]) -> Float[Array, ""]:
    """c of the line energy."""
    return 0.5 + 0.4 * jnp.sin(1.5 * p[0] + p[1]) - 0.2 * p[2]


def tangential_velocity(nu: Float[Array, "3"], p: Float[Array, "3"]) -> Float[Array, "3"]:
    """T of the tangential direction: no symmetry of the test surfaces makes its work vanish."""
    w = jnp.stack([p[0] + p[1] ** 2, 0.5 * p[2] - 0.4 * p[1], 0.7 * p[2] + p[0] * p[1]])
    return w - jnp.dot(w, nu) * nu


def study_energies(c: Float[Array, " nodes"]) -> dict[str, AbstractEnergy]:
    """One energy of each kind, by name; `c` are the nodal values of the carried field."""
    energies = (
        Willmore(),
        CanhamHelfrich(0.6, 0.2, 0.7),
        SurfaceTension(0.8),
        Pressure(0.9),
        OsmoticPressure(6.0, 3.0, 1.0, 0.5),
        AreaDifference(1.2, 0.3, 0.1),
        CarriedLineEnergy(c),
    )
    return dict(zip(ENERGIES, energies, strict=True))


@eqx.filter_jit
def exact_derivatives(surface: ExactSurface) -> dict[str, Float[Array, "3"]]:
    r"""Normal and tangential derivative of every energy, and $\int |gV| + |q\cdot\nabla V|$."""
    p, weights = surface.points()
    level_set = surface.level_set
    nu, H = level_set.normal(p), level_set.mean_curvature(p)
    whole = Whole(
        jnp.sum(weights),
        jnp.sum(weights * jnp.sum(p * nu, axis=1)) / 3,
        jnp.sum(weights * H),
    )
    energies = study_energies(jnp.zeros(1))

    def carried_away(p):
        """-T·∇c: how c at a fixed place changes when T carries it."""
        T = tangential_velocity(level_set.normal(p[None])[0], p)
        return -jnp.dot(T, jax.grad(carried_field)(p))

    def at(p):
        H = Jet(level_set.mean_curvature(p[None])[0], level_set.mean_curvature_gradient(p[None])[0])
        c, V = surface.jet(carried_field, p), surface.jet(normal_speed, p)
        here = Geometry(H, level_set.weingarten(p[None])[0], c)
        change = surface.jet(carried_away, p)
        out = []
        for energy in energies.values():
            g, q = first_variation(energy, here, whole)
            terms = jnp.stack([g * V.value, jnp.dot(q, V.grad)])
            along = jnp.zeros(())
            if isinstance(energy, CarriedLineEnergy):
                along = energy.by_field(c, change)
            out.append(jnp.stack([jnp.sum(terms), along, jnp.sum(jnp.abs(terms))]))
        return jnp.stack(out)

    values = jnp.tensordot(weights, jax.vmap(at)(p), axes=1)
    return dict(zip(energies, values, strict=True))


@eqx.filter_jit
def discrete_derivatives(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    normal: Float[Array, "nodes 3"],
) -> dict[str, Float[Array, "2"]]:
    """Derivatives of the discrete energies by JAX, in the two directions."""
    V = jax.vmap(normal_speed)(x)
    T = jax.vmap(tangential_velocity)(normal, x)
    energies = study_energies(jax.vmap(carried_field)(x))

    def all_of(mesh, x):
        return jnp.stack([energy(mesh, x) for energy in energies.values()])

    directions = jnp.stack([V[:, None] * normal, T])
    slopes = jax.vmap(ft.partial(shape_derivative, all_of, mesh, x))(directions)
    return {name: slopes[:, k] for k, name in enumerate(energies)}


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
    energies = study_energies(fields["c"])
    total = integrate(mesh, x, lambda _, f: f.H.value, fields)
    whole = Whole(area(mesh, x), volume(mesh, x), total)

    def density(_, f):
        here = Geometry(f.H, weingarten(f.nu), f.c)
        variations = [first_variation(energy, here, whole) for energy in energies.values()]
        return jnp.stack([g * f.V.value + jnp.dot(q, f.V.grad) for g, q in variations])

    values = integrate(mesh, x, density, fields)
    return {name: values[k] for k, name in enumerate(energies)}


def shape_derivative_rows(
    surface: ExactSurface, levels: Sequence[int] = (1, 2, 3), degree: int = 2
) -> list[Row]:
    r"""The study of one surface as a table: one row per energy, direction and mesh.

    Columns: `surface`, `energy`, `direction`, `nodes`, `h`, the derivative `autodiff` of the
    discrete energy, `exact`, the `error` between them, `recovered` and its `recovered_error` (only
    in the normal direction), and the orders observed from the row before. Errors are relative to
    $\int |gV| + |q\cdot\nabla V|$, which stays away from zero when the derivative does not; the
    tangential derivative of all but the line energy is exactly zero.
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
        *answers, scale = exact[name]
        for k, direction in enumerate(DIRECTIONS):
            own = []
            for numbers, autodiff, recovered in found:
                row = {"surface": surface.name, "energy": name, "direction": direction} | numbers
                row |= {"autodiff": float(autodiff[name][k]), "exact": float(answers[k])}
                row["error"] = abs(row["autodiff"] - row["exact"]) / float(scale)
                if k == 0:
                    row["recovered"] = float(recovered[name])
                    difference = abs(row["recovered"] - row["exact"])
                    row["recovered_error"] = difference / float(scale)
                own.append(row)
            rows += with_orders(own, "h", ("error", "recovered_error")[: 2 - k])
    return rows

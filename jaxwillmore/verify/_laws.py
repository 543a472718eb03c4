r"""Spheres under any law: ordinary differential equations for the radius, and flows that obey them.

On a sphere a gradient flow of $E$ moves with $\dot R = -E'(R)/(4\pi R^2)$, $E(R)$ being the energy
of the sphere. That says nothing about weak forms, multipliers or meshes, and so judges all three.
"""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from .._types import Scalar
from ..energies import AbstractEnergy, AbstractGlobalEnergy, Pressure, SurfaceTension, terms_of
from ..flows import AbstractLaw, Loads, MeanCurvatureFlow, System, WillmoreFlow
from ..surface import AbstractLevelSet, Sphere
from ._problems import Problem


def sphere_energy(
    R: Scalar,
    bending_modulus: float | Scalar = 0.5,
    spontaneous_curvature: float | Scalar = 0.0,
    energy: AbstractEnergy | None = None,
) -> Scalar:
    r"""$4\pi b_b (2 - H_0 R)^2 + f(4\pi R^2, \tfrac43\pi R^3, 8\pi R)$ of a sphere of radius R.

    `energy` is a global energy $f(A, V_p, \int H)$, or a sum of such.

    **Raises:** `ValueError` for an energy that is not global.
    """
    bending = 4 * jnp.pi * bending_modulus * (2 - spontaneous_curvature * R) ** 2
    if energy is None:
        return bending
    sizes = 4 * jnp.pi * R**2, 4 * jnp.pi * R**3 / 3, 8 * jnp.pi * R
    for factor, term in terms_of(energy):
        if not isinstance(term, AbstractGlobalEnergy):
            raise ValueError(f"`energy` must be global; {type(term).__name__} is local.")
        bending = bending + factor * term.of(*sizes)
    return bending


def radius_after(t: float, rate: Callable[[Scalar], Scalar], radius: float = 1.0) -> float:
    r"""Solution at time `t` of $\dot R = $ `rate(R)` from `radius`, to about eleven digits.

    **Raises:** `ValueError` if there is no solution up to `t` (the sphere has vanished).
    """
    if t == 0:
        return radius
    compiled = jax.jit(rate)
    found = solve_ivp(
        lambda _, R: np.asarray(compiled(jnp.asarray(R[0])))[None],
        (0.0, t),
        [radius],
        method="DOP853",
        rtol=1e-12,
        atol=1e-13 * radius,
    )
    R = float(found.y[0, -1])
    if not (found.success and math.isfinite(R) and R > 0):
        raise ValueError(f"The radius has no value at t = {t}: the sphere has vanished before.")
    return R


def loaded_sphere_problem(
    energy: AbstractEnergy,
    t1: float,
    bending_modulus: float = 0.5,
    spontaneous_curvature: float = 0.0,
    name: str = "loaded sphere",
) -> Problem:
    """The unit sphere under Canham–Helfrich flow with a global energy."""

    def rate(R):
        slope = jax.grad(sphere_energy)(R, bending_modulus, spontaneous_curvature, energy)
        return -slope / (4 * jnp.pi * R**2)

    flow = System(WillmoreFlow(bending_modulus, spontaneous_curvature), Loads(energy))
    return _sphere_problem(name, flow, rate, t1)


def speed_problem(speed: Callable | None, t1: float, name: str = "sphere") -> Problem:
    r"""The unit sphere under $V = -F(H)$: $\dot R = -F(2/R)$; `None` is mean curvature flow."""
    flow = MeanCurvatureFlow(speed)
    return _sphere_problem(name, flow, lambda R: -flow.speed(2 / R), t1)


def _sphere_problem(name: str, flow: System | AbstractLaw, rate: Callable, t1: float) -> Problem:
    def surface(t: float) -> AbstractLevelSet:
        return Sphere(radius_after(float(t), rate))

    return Problem(name, flow, surface, lambda x: x, t1)


def balanced_flow(
    spontaneous_curvature: float = 0.0,
    surface_tension: float = 0.0,
    bending_modulus: float = 0.5,
    radius: float = 1.0,
) -> System:
    r"""Canham–Helfrich flow with tension and the pressure under which the sphere is at rest.

    $P = 2\sigma/R - 2b_b H_0 (2 - H_0 R)/R^2$; small modes of the sphere change at `mode_rate`.
    """
    b, H0, R = 2 * bending_modulus, spontaneous_curvature, radius
    pressure = 2 * surface_tension / R - b * H0 * (2 - H0 * R) / R**2
    energy = SurfaceTension(surface_tension) + Pressure(pressure)
    return System(WillmoreFlow(bending_modulus, H0), Loads(energy))

r"""Exact solutions of the flows, to measure errors against.

Conventions: $H = \kappa_1 + \kappa_2$, outward normal, energy $\int b_b (H - H_0)^2$ and
$\kappa = 2 b_b$.
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from scipy.optimize import brentq

from .._types import Nodes, Scalar
from ..surface import AbstractLevelSet, Ellipsoid


def sphere_radius(
    t: float,
    radius: float = 1.0,
    bending_modulus: float = 0.5,
    spontaneous_curvature: float = 0.0,
) -> float:
    r"""Radius at time `t` of a sphere that starts with `radius`.

    $$ \dot R = \kappa H_0 (2 - H_0 R)/R^2, \qquad
       t = -\frac{1}{\kappa H_0^4}
       \Big[\tfrac12 s^2 + 2 s + 4 \ln|2 - s|\Big]_{H_0 R(0)}^{H_0 R(t)} $$

    The bracket is solved for $y = \ln|2 - s|$ by bracketing, so that the approach to the
    equilibrium $R = 2/H_0$ costs no digits.

    **Raises:** `ValueError` if `radius` or `bending_modulus` is not positive, or if the sphere has
    vanished before `t` (only for $H_0 < 0$).
    """
    if not (radius > 0 and bending_modulus > 0):
        raise ValueError(
            f"`radius` and `bending_modulus` must be positive; got {radius} and {bending_modulus}."
        )
    H0 = spontaneous_curvature
    start = H0 * radius
    if H0 == 0 or start == 2:
        return radius
    side = math.copysign(1.0, 2 - start)
    elapsed = 2 * bending_modulus * H0**4 * t

    def remaining(y: float) -> float:
        s = 2 - side * math.exp(y)
        return (s - start) * ((s + start) / 2 + 2) + 4 * (y - begin) + elapsed

    begin = math.log(abs(2 - start))
    # The bracket increases with y; s² and s are bounded on the way, so this is far enough.
    low = begin - (elapsed + (abs(start) + 4) ** 2) / 4 - 1
    high = begin
    if H0 < 0:  # s rises from a negative value to 0, where the sphere is gone
        low = math.log(2)
        if remaining(low) > 0:
            raise ValueError(f"The sphere has vanished before t = {t}.")
    if elapsed == 0:
        return radius
    y = brentq(remaining, low, high, xtol=1e-15, rtol=1e-15)  # pyright: ignore[reportArgumentType]
    return (2 - side * math.exp(float(y))) / H0  # pyright: ignore[reportArgumentType]


def mode_rate(
    mode: int,
    radius: float = 1.0,
    bending_modulus: float = 0.5,
    spontaneous_curvature: float = 0.0,
    surface_tension: float = 0.0,
) -> float:
    r"""Growth rate of a spherical harmonic of degree `mode` on a sphere in equilibrium.

    $$ -\frac{\kappa}{R^4}(l-1)(l+2)\Big[l(l+1) + \frac{\sigma R^2}{\kappa} + \tfrac12 (H_0R)^2
       - 2H_0R\Big] $$

    for $E = \int \tfrac\kappa2 (H - H_0)^2 + \sigma A - PV$ with the pressure that balances the
    radius.
    Willmore flow: $-(l-1)l(l+1)(l+2)/R^4$, that is −24 and −120 for l = 2 and 3 on the unit
    sphere.
    """
    if mode < 0:
        raise ValueError(f"`mode` must not be negative; got {mode}.")
    kappa, s = 2 * bending_modulus, spontaneous_curvature * radius
    bracket = mode * (mode + 1) + surface_tension * radius**2 / kappa + 0.5 * s**2 - 2 * s
    return -kappa / radius**4 * (mode - 1) * (mode + 2) * bracket


def willmore_velocity(
    surface: AbstractLevelSet,
    x: Nodes,
    bending_modulus: float | Scalar = 0.5,
    spontaneous_curvature: float | Scalar = 0.0,
) -> Float[Array, " nodes"]:
    r"""Exact normal velocity of the Canham–Helfrich law at points of a level set.

    $$ V = 2 b_b\,[\Delta_\Gamma H + |A|^2 (H - H_0) - \tfrac12 H (H - H_0)^2] $$

    $\Delta_\Gamma H$ is the trace of the tangential Hessian of the curvature of the level sets,
    $\Delta h - \nu\cdot D^2 h\,\nu - H\,\partial_\nu h$; all derivatives are made by JAX.
    """
    kappa, H0 = 2 * jnp.asarray(bending_modulus, float), jnp.asarray(spontaneous_curvature, float)

    def curvature(p):
        return surface.mean_curvature(p[None])[0]

    def at(p):
        nu, A = surface.normal(p[None])[0], surface.weingarten(p[None])[0]
        H, gradient, hessian = curvature(p), jax.grad(curvature)(p), jax.hessian(curvature)(p)
        laplacian = jnp.trace(hessian) - nu @ hessian @ nu - H * jnp.dot(gradient, nu)
        return kappa * (laplacian + jnp.sum(A * A) * (H - H0) - 0.5 * H * (H - H0) ** 2)

    return jax.vmap(at)(x)


class MovingEllipsoid(eqx.Module):
    r"""A manufactured solution: an ellipsoid whose semi-axes are given functions of time.

    The points $x = (a_1 n_1, a_2 n_2, a_3 n_3)$ of the parametrisation by the unit sphere move
    with normal velocity $V = \nu\cdot\dot x$. `forcing` is what has to be added to the law for
    this; pass it as `Forcing(exact.forcing)`. The nodes of the flow move with
    $V\nu$ alone, so compare surfaces, not nodes.

    **Arguments:**

    - `semi_axes`: a smooth function of time to three lengths, built of JAX operations.
    - `bending_modulus`, `spontaneous_curvature`: those of the flow.
    """

    semi_axes: Callable[[Scalar], Float[Array, "3"]] = eqx.field(static=True)
    bending_modulus: Scalar = eqx.field(default=0.5, converter=lambda v: jnp.asarray(v, float))
    spontaneous_curvature: Scalar = eqx.field(
        default=0.0, converter=lambda v: jnp.asarray(v, float)
    )

    def surface(self, t: float | Scalar) -> Ellipsoid:
        """The exact surface at time `t`."""
        return Ellipsoid(self.semi_axes(jnp.asarray(t, float)))

    def normal_velocity(self, t: Scalar, p: Float[Array, "3"]) -> Scalar:
        """V of the exact surface; points off the surface are taken along the unit sphere."""
        axes, rates = jax.jvp(self.semi_axes, (t,), (jnp.ones_like(t),))
        n = p / axes
        n = n / jnp.sqrt(jnp.sum(n * n))
        nu = Ellipsoid(axes).normal((axes * n)[None])[0]
        return jnp.dot(nu, rates * n)

    def forcing(self, t: Scalar, p: Float[Array, "3"]) -> Scalar:
        """What the law lacks at time `t` and point `p`."""
        axes = self.semi_axes(t)
        n = p / axes
        n = n / jnp.sqrt(jnp.sum(n * n))
        of_law = willmore_velocity(
            Ellipsoid(axes), (axes * n)[None], self.bending_modulus, self.spontaneous_curvature
        )[0]
        return self.normal_velocity(t, p) - of_law


class PerturbedSphere(AbstractLevelSet):
    r"""$r = R\,(1 + \varepsilon P_l(\cos\theta))$: a zonal mode on a sphere.

    To first order in the amplitude it keeps its form under the flow, with $\varepsilon$ changing at
    `mode_rate`.
    """

    radius: Scalar = eqx.field(default=1.0, converter=lambda v: jnp.asarray(v, float))
    amplitude: Scalar = eqx.field(default=0.0, converter=lambda v: jnp.asarray(v, float))
    mode: int = eqx.field(default=2, static=True)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        r = jnp.sqrt(jnp.sum(point * point))
        return r - self.radius * (1.0 + self.amplitude * legendre(self.mode, point[2] / r))


def legendre(mode: int, u: Scalar) -> Scalar:
    """Legendre polynomial of degree `mode`, by its three-term recurrence."""
    previous, value = jnp.zeros_like(u), jnp.ones_like(u)
    for n in range(mode):
        previous, value = value, ((2 * n + 1) * u * value - n * previous) / (n + 1)
    return value

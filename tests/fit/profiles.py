"""Exact axisymmetric equilibria: the shape equations as ordinary differential equations."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from jaxwillmore.mesh import icosphere


def meridian(H0, tension, pressure, bracket, crossing=1):
    r"""Half a meridian of an equilibrium at κ = 1 that is symmetric about its equator.

    With the tilt ψ of the meridian over its arclength s, U = ψ', radius X and height Z, from the
    pole ψ = 0 to the equator ψ = π/2:

        U' = −U cosψ/X + cosψ sinψ/X² + γ sinψ/X − ½ P X cosψ
        γ' = ½(U − H0)² − sin²ψ/(2X²) − P X sinψ + σ

    (Seifert, Berndl, Lipowsky 1991, with P inside minus outside). U(0) is the root in `bracket` of
    γ = 0, which is U' = 0, at the equator; that is where ψ = π/2 for the `crossing`-th time.

    **Returns:** the length of the half meridian, and a function from arclength to (X, Z).
    """

    def rates(_, y):
        psi, U, gamma, X, _ = y
        sin, cos = np.sin(psi), np.cos(psi)
        dU = -U * cos / X + cos * sin / X**2 + gamma * sin / X - 0.5 * pressure * X * cos
        dgamma = 0.5 * (U - H0) ** 2 - 0.5 * (sin / X) ** 2 - pressure * X * sin + tension
        return [U, dU, dgamma, cos, -sin]

    def equator(_, y):
        return y[0] - 0.5 * np.pi

    equator.terminal = crossing  # pyright: ignore
    e = 1e-3

    def shoot(U0):
        # The series at the pole: ψ = U0 s + c s³ and γ = γ'(0) s.
        slope = -H0 * U0 + 0.5 * H0**2 + tension
        c = (slope * U0 - 0.5 * pressure) / 8
        start = [U0 * e + c * e**3, U0 + 3 * c * e**2, slope * e, e - U0**2 * e**3 / 6]
        start += [-0.5 * U0 * e**2]
        return solve_ivp(
            rates, (e, 9.0), start, events=equator, rtol=1e-10, atol=1e-12, dense_output=True
        )

    U0 = float(np.asarray(brentq(lambda U0: shoot(U0).y[2, -1], *bracket, xtol=1e-12)))
    run = shoot(U0)

    def at(s):
        X, Z = run.sol(np.maximum(s, e))[3:]
        small = s < e
        return np.where(small, s, X), np.where(small, -0.5 * U0 * s**2, Z)

    return run.t[-1], at


def equilibrium_nodes(H0, tension, pressure, bracket, crossing=1, level=2):
    """A P2 mesh whose nodes lie on the exact equilibrium; arclength is proportional to angle."""
    length, at = meridian(H0, tension, pressure, bracket, crossing)
    mesh, u = icosphere(level, degree=2)
    u = np.asarray(u)
    angle = np.arccos(np.clip(u[:, 2], -1.0, 1.0))
    X, Z = at(length * np.minimum(angle, np.pi - angle) / (0.5 * np.pi))
    half = -at(np.array([length]))[1][0]
    ring = np.hypot(u[:, 0], u[:, 1])
    unit = u[:, :2] / np.where(ring > 0, ring, 1.0)[:, None]
    height = np.where(u[:, 2] >= 0, half + Z, -half - Z)
    return mesh, np.concatenate([X[:, None] * unit, height[:, None]], axis=1)


# H0, σ/κ, P/κ, bracket of the curvature at the pole, crossing: near v = 0.8, R0 = 1.
PROLATE = (0.0, -5.112, -12.78, (1.7, 1.8), 2)
PROLATE_WITH_H0 = (1.2, -1.79, -6.06, (1.7, 1.8), 2)
# Near v = 0.65.
OBLATE = (0.0, -5.004, -15.396, (-1.0, -0.9), 1)

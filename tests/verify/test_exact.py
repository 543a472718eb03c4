"""The exact solutions solve what they claim to solve, by ways of their own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxwillmore.surface import Ellipsoid, Sphere, Torus
from jaxwillmore.verify import (
    MovingEllipsoid,
    PerturbedSphere,
    legendre,
    mode_rate,
    sphere_radius,
    willmore_velocity,
)


@pytest.mark.parametrize("R, b_b, H0", [(1.0, 0.5, 1.0), (3.0, 0.7, 1.0), (1.0, 0.5, -0.6)])
def test_the_radius_of_a_sphere_solves_its_equation(R, b_b, H0):
    """Ṙ = bH₀(2 − H₀R)/R², against a Runge–Kutta integrator."""
    b, t = 2 * b_b, 0.2
    law = lambda _, y: b * H0 * (2 - H0 * y) / y**2
    expected = solve_ivp(law, (0.0, t), [R], rtol=1e-12, atol=1e-14).y[0, -1]
    assert sphere_radius(t, R, b_b, H0) == pytest.approx(expected, rel=1e-10)
    assert sphere_radius(0.0, R, b_b, H0) == R


def test_a_sphere_tends_to_its_spontaneous_curvature_and_without_one_it_stays():
    assert sphere_radius(1e3, 1.0, 0.5, 1.0) == pytest.approx(2.0, rel=1e-12)
    assert sphere_radius(7.0, 1.3) == 1.3
    with pytest.raises(ValueError, match="vanished before t = 10"):
        sphere_radius(10.0, 1.0, 0.5, -1.0)
    with pytest.raises(ValueError, match="must be positive"):
        sphere_radius(1.0, -1.0)


def test_mode_rates():
    """−(l−1)l(l+1)(l+2) for Willmore flow; rigid motions (l = 1) stand still whatever the loads."""
    assert [mode_rate(mode) for mode in (1, 2, 3)] == [0.0, -24.0, -120.0]
    assert mode_rate(2, radius=2.0) == -24 / 16
    assert mode_rate(1, 1.3, 0.7, 0.4, 2.0) == 0.0
    # A tension stabilises; H0 = 2/R costs the sphere nothing.
    assert mode_rate(2, surface_tension=1.0) == -24 - 4
    assert mode_rate(2, spontaneous_curvature=2.0) == -4 * (6 + 2 - 4)


@pytest.mark.parametrize(
    "surface, point, expected",
    [
        (Sphere(2.0), (0.0, 1.2, 1.6), 0.0),
        # On the equators of a torus κ = 1/r and ±1/(R ± r), and H along the tube is known:
        # V = ΔH − ½H³ + |A|²H, ΔH by the formula for surfaces of revolution.
        (Torus(2.0, 0.5), (2.5, 0.0, 0.0), None),
    ],
)
def test_the_velocity_of_the_law(surface, point, expected):
    found = float(willmore_velocity(surface, jnp.asarray([point]))[0])
    if expected is None:
        R, r = 2.0, 0.5
        H = lambda s: 1 / r + np.cos(s / r) / (R + r * np.cos(s / r))
        rho = lambda s: R + r * np.cos(s / r)
        h = 1e-3
        flux = lambda s: rho(s) * (H(s + h / 2) - H(s - h / 2)) / h
        laplacian = (flux(h / 2) - flux(-h / 2)) / h / rho(0.0)
        A2 = 1 / r**2 + 1 / (R + r) ** 2
        expected = laplacian - 0.5 * H(0.0) ** 3 + A2 * H(0.0)
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-10)


@pytest.mark.slow
def test_the_clifford_torus_and_its_spontaneous_curvature():
    p = jnp.asarray([[1 + np.sqrt(0.5), 0.0, 0.0], [0.0, 1.0, np.sqrt(0.5)]])
    np.testing.assert_allclose(willmore_velocity(Torus(1.0, np.sqrt(0.5)), p), 0.0, atol=1e-9)
    # On the unit sphere V = b H₀(2 − H₀).
    V = willmore_velocity(Sphere(1.0), jnp.asarray([[0.6, 0.0, 0.8]]), 0.7, 0.5)
    np.testing.assert_allclose(V, 1.4 * 0.5 * 1.5, rtol=1e-10)


def test_the_manufactured_ellipsoid_moves_as_it_says():
    """V by a difference of exact surfaces; forcing plus law is V."""
    axes = lambda t: jnp.stack([1.0 + 0.2 * t, 1.2 - 0.4 * t, 1.4 + 0.3 * t * t])
    exact = MovingEllipsoid(axes)
    t, h = jnp.asarray(0.3), 1e-4
    p = Ellipsoid(axes(t)).project(jnp.asarray([[0.5, 0.7, 0.9]]))
    nu = Ellipsoid(axes(t)).normal(p)[0]

    def height(s):
        """Where the surface at time t + s crosses the line through p along ν."""
        F = lambda d: Ellipsoid(axes(t + s))(p[0] + d * nu)
        d = jnp.asarray(0.0)
        for _ in range(4):
            d = d - F(d) / jax.grad(F)(d)
        return float(d)

    V = (height(h) - height(-h)) / (2 * h)
    assert float(exact.normal_velocity(t, p[0])) == pytest.approx(V, rel=1e-5)
    law = float(willmore_velocity(Ellipsoid(axes(t)), p)[0])
    assert float(exact.forcing(t, p[0])) + law == pytest.approx(V, rel=1e-5)


def test_perturbed_sphere_and_legendre():
    u = jnp.asarray(0.3)
    assert float(legendre(0, u)) == 1.0 and float(legendre(1, u)) == pytest.approx(0.3)
    assert float(legendre(3, u)) == pytest.approx(2.5 * 0.027 - 1.5 * 0.3)
    # H of r = 1 + εP_l is 2 + ε(l−1)(l+2)P_l + O(ε²).
    p = jnp.asarray([[0.6, 0.0, 0.8]])
    for mode in (2, 3):
        H = lambda e, mode=mode: PerturbedSphere(1.0, e, mode).mean_curvature(
            p * (1 + e * legendre(mode, p[0, 2]))
        )[0]
        slope = (float(H(1e-4)) - float(H(-1e-4))) / 2e-4
        expected = (mode - 1) * (mode + 2) * float(legendre(mode, p[0, 2]))
        assert slope == pytest.approx(expected, rel=1e-6)

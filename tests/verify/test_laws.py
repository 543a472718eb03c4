"""The laws that runs are judged by, against closed forms. No flow is run here."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import OsmoticPressure, Pressure, SurfaceTension, Willmore
from jaxwillmore.flows import Loads
from jaxwillmore.surface import Sphere
from jaxwillmore.verify import (
    balanced_flow,
    loaded_sphere_problem,
    mode_rate,
    radius_after,
    speed_problem,
    sphere_energy,
    sphere_radius,
)


def radius_of(problem, t):
    sphere = problem.surface(t)
    assert isinstance(sphere, Sphere)
    return float(sphere.radius)


@pytest.mark.parametrize("H0, t", [(1.0, 0.5), (-0.5, 0.2), (3.0, 0.05)])
def test_the_radius_with_spontaneous_curvature_agrees_with_its_implicit_solution(H0, t):
    problem = loaded_sphere_problem(Pressure(0.0), t, 0.7, H0)
    exact = sphere_radius(t, 1.0, 0.7, H0)
    np.testing.assert_allclose(radius_of(problem, t), exact, rtol=1e-11)


@pytest.mark.parametrize(
    "energy, radius",
    [
        (SurfaceTension(0.3), np.sqrt(1 - 4 * 0.3 * 0.5)),  # R' = −2σ/R
        (2.0 * Pressure(0.4), 1 + 0.8 * 0.5),  # R' = P
    ],
    ids=["tension", "pressure"],
)
def test_radii_with_closed_forms(energy, radius):
    problem = loaded_sphere_problem(energy, 0.5)
    np.testing.assert_allclose(radius_of(problem, 0.5), radius, rtol=1e-11)
    assert radius_of(problem, 0.0) == 1.0


def test_osmosis_stops_where_the_concentrations_are_equal():
    n, c = 5.0, 1.0
    energy = OsmoticPressure(n, c, temperature=1.0, gas_constant=0.5)
    R = radius_of(loaded_sphere_problem(energy, 50.0), 50.0)
    np.testing.assert_allclose(4 * np.pi * R**3 / 3, n / c, rtol=1e-9)


@pytest.mark.parametrize(
    "speed, t, radius",
    [
        (None, 0.1, np.sqrt(1 - 0.4)),
        (lambda H: -1 / H, 0.4, np.exp(0.2)),
        (lambda H: H**2, 0.05, (1 - 12 * 0.05) ** (1 / 3)),
    ],
    ids=["mean curvature", "inverse", "square"],
)
def test_radii_under_functions_of_the_curvature(speed, t, radius):
    np.testing.assert_allclose(radius_of(speed_problem(speed, t), t), radius, rtol=1e-11)


def test_a_sphere_that_has_vanished_is_reported():
    with pytest.raises(ValueError, match="no value at t = 1.0: the sphere has vanished"):
        radius_after(1.0, lambda R: -2 / R)


def test_the_balanced_sphere_is_stationary_for_its_energy_and_breathes_at_the_rate_of_mode_0():
    r"""The rate of $l = 0$ is the derivative of $-E'(R)/(4\pi R^2)$; the pressure drops out."""
    H0, sigma, b_b, R0 = -0.7, 0.4, 0.8, 1.3
    _, loads = balanced_flow(H0, sigma, b_b, R0).laws
    assert isinstance(loads, Loads)

    def rate(R):
        slope = jax.grad(sphere_energy)(R, b_b, H0, loads.energy)
        return -slope / (4 * jnp.pi * R**2)

    at, slope = jax.value_and_grad(rate)(jnp.asarray(R0))
    np.testing.assert_allclose(at, 0.0, atol=1e-13)
    np.testing.assert_allclose(slope, mode_rate(0, R0, b_b, H0, sigma), rtol=1e-12)


def test_a_local_energy_is_refused():
    with pytest.raises(ValueError, match="`energy` must be global; Willmore is local"):
        sphere_energy(jnp.asarray(1.0), energy=Willmore())


def test_the_whole_sphere_may_shift():
    """l = 1 is a translation: no rate, whatever the load."""
    assert mode_rate(1, 1.3, 0.8, -0.7, 0.4) == 0.0

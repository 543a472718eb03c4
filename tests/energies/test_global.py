"""Energies of area, volume and total mean curvature: values and slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.energies import (
    AreaDifference,
    AreaPenalty,
    OsmoticPressure,
    Pressure,
    SurfaceTension,
    VolumePenalty,
    Willmore,
    terms_of,
)


@pytest.fixture(scope="module")
def sphere():
    return jw.mesh.icosphere(1, degree=2, radius=1.5)


A, V, M = (jnp.asarray(v) for v in (7.0, 1.5, 9.0))


@pytest.mark.parametrize(
    "energy, slopes",
    [
        (SurfaceTension(0.3), (0.3, 0.0, 0.0)),
        (Pressure(0.3), (0.0, -0.3, 0.0)),
        (AreaPenalty(2.0, 5.0), (2.0 * 2.0 / 5.0, 0.0, 0.0)),
        (VolumePenalty(2.0, 3.0), (0.0, 2.0 * (0.5 - 1.0) / 3.0, 0.0)),
        # -(pressure) with pressure = iRT (n/V - c)
        (OsmoticPressure(6.0, 2.0, 3.0, 0.5, 2.0), (0.0, -2.0 * 0.5 * 3.0 * (4.0 - 2.0), 0.0)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_partial_derivatives_are_tension_and_minus_pressure(energy, slopes):
    np.testing.assert_allclose(jax.grad(energy.of, argnums=(0, 1, 2))(A, V, M), slopes, atol=1e-14)


def test_osmotic_energy_and_pressure_vanish_at_the_isotonic_volume():
    energy = OsmoticPressure(6.0, 2.0, 3.0, 0.5)
    value, slope = jax.value_and_grad(energy.of, argnums=1)(A, jnp.asarray(3.0), M)
    np.testing.assert_allclose([value, slope], 0.0, atol=1e-15)
    assert energy.of(A, V, M) > 0


def test_area_difference_of_a_sphere(sphere):
    """ΔA = D ∫H = 8πR D."""
    mesh, x = sphere
    D, R, dA0 = 0.01, 1.5, 0.2
    exact = 0.5 * 3.0 * np.pi / (4 * np.pi * R**2 * D**2) * (D * 8 * np.pi * R - dA0) ** 2
    np.testing.assert_allclose(AreaDifference(3.0, dA0, D)(mesh, x), exact, rtol=2e-3)


def test_energies_form_an_algebra(sphere):
    mesh, x = sphere
    tension, pressure, bending = SurfaceTension(0.3), Pressure(0.2), Willmore()
    total = 2.0 * (tension + pressure) + bending * 0.5
    expected = 2 * (tension(mesh, x) + pressure(mesh, x)) + 0.5 * bending(mesh, x)
    np.testing.assert_allclose(total(mesh, x), expected, rtol=1e-14)
    assert [(float(f), type(t).__name__) for f, t in terms_of(total)] == [
        (2.0, "SurfaceTension"),
        (2.0, "Pressure"),
        (0.5, "Willmore"),
    ]


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf, "1", None, [1.0]])
def test_parameters_without_meaning_are_refused(bad):
    with pytest.raises(ValueError, match="`solute_amount` must be"):
        OsmoticPressure(bad, 1.0)
    with pytest.raises(ValueError, match="`preferred_area` must be"):
        AreaPenalty(1.0, bad)

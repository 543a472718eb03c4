"""Laws of motion, Gauss–Bonnet, ∇H = Δν + |A|²ν, the spectrum of the sphere."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import verify
from jaxwillmore.mesh import icosphere
from jaxwillmore.verify._identities import _second_variation, chart_geometry


def test_curvature_of_a_chart_is_exact_on_a_cone_and_a_sphere():
    """A sphere of radius R has 2/R; a cone at distance ρ from its axis has cos α/ρ."""
    R, slope = 1.7, 0.5

    def sphere(uv):
        theta, phi = 1.1 + uv[0], 0.3 + uv[1]
        s = jnp.sin(theta)
        return R * jnp.stack([s * jnp.cos(phi), s * jnp.sin(phi), jnp.cos(theta)])

    def cone(uv):
        rho, phi = 2.0 + uv[0], 0.3 + uv[1]
        return jnp.stack([rho * jnp.cos(phi), rho * jnp.sin(phi), -slope * rho])

    nu, H = chart_geometry(sphere, jnp.zeros(2))
    np.testing.assert_allclose(H, 2 / R, rtol=1e-14)
    np.testing.assert_allclose(nu, sphere(jnp.zeros(2)) / R, rtol=1e-14)
    _, H = chart_geometry(cone, jnp.zeros(2))
    np.testing.assert_allclose(H, slope / np.sqrt(1 + slope**2) / 2.0, rtol=1e-13)


@pytest.mark.parametrize(
    "make",
    [
        verify.bumpy_surface,
        pytest.param(verify.round_torus, marks=pytest.mark.slow),
        pytest.param(verify.triaxial_ellipsoid, marks=pytest.mark.slow),
    ],
)
def test_material_derivatives_of_the_exact_surface(make):
    """∂•H = −ΔV − |A|²V, ∂•ν = −∇V, ∂_νH = −|A|², to rounding."""
    defects = verify.material_derivatives(make(), 97)
    assert len(defects) == 3
    for name, defect in defects.items():
        assert float(defect) < 1e-12, name


@pytest.mark.slow
def test_discrete_identities_hold_with_order_four():
    rows = verify.identity_rows(verify.bumpy_surface(), (1, 2))
    orders = {row["identity"]: row["error_order"] for row in rows if "h" in row}
    assert len(orders) == 2
    for name, order in orders.items():
        assert 3.5 < order < 4.5, name
    exact = next(row for row in rows if row["identity"] == "Gauss-Bonnet, exact")
    assert exact["error"] < 1e-12


def test_second_variation_of_the_sphere():
    """(l−1)l(l+1)(l+2) for l = 2, 3, 4; order 3.6, 0.7 % at 642 nodes for l = 4."""
    rows = verify.second_variation_rows((2,))
    assert [row["exact"] for row in rows] == [24, 120, 360]
    for row in rows:
        assert row["error"] < 8e-3, row


def test_translations_cost_nothing():
    """l = 1 moves the sphere: no second variation, up to the order of the mesh."""
    mesh, x = icosphere(2, 2)
    assert abs(float(_second_variation(mesh, x, x[:, 2]))) < 2e-2

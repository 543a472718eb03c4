"""Autodiff of the discrete energies and the formulas of the smooth ones converge to each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import verify
from jaxwillmore.energies import AbstractEnergy, CanhamHelfrich, Willmore
from jaxwillmore.fem import Jet
from jaxwillmore.verify._shape_derivative import (
    ENERGIES,
    OF_A_CONCENTRATION,
    exact_derivatives,
    normal_speed,
    shape_derivative_rows,
)


@pytest.fixture(scope="module")
def bumpy():
    return verify.bumpy_surface()


@pytest.fixture(scope="module")
def exact(bumpy):
    return exact_derivatives(bumpy)


# 1. The exact side.
@pytest.mark.slow
def test_quadrature_of_the_exact_surface_is_spectral(bumpy):
    """Area and volume do not change when half of the points go."""

    def measures(surface):
        p, w = surface.points()
        nu = surface.level_set.normal(p)
        return float(jnp.sum(w)), float(jnp.sum(w * jnp.sum(p * nu, axis=1)) / 3)

    coarse = verify.sphere_like("coarse", _map_of(bumpy), bumpy.level_set, n=24)
    np.testing.assert_allclose(measures(coarse), measures(bumpy), rtol=1e-10)


def _map_of(surface):
    """n -> r(n) n back from the chart, whose base point is n itself."""
    return lambda n: surface.chart(n, jnp.zeros(2))


@pytest.mark.parametrize("name, b, H0", [("Willmore", 0.5, 0.0), ("Canham-Helfrich", 0.6, 0.7)])
@pytest.mark.slow
def test_the_weak_formula_equals_the_strong_one(bumpy, exact, name, b, H0):
    """∫ g V + q·∇V = −∫ (law of the flow) V: integration by parts, to rounding."""
    p, w = bumpy.points()
    law = verify.willmore_velocity(bumpy.level_set, p, b, H0)
    strong = -jnp.sum(w * law * jax.vmap(normal_speed)(p))
    np.testing.assert_allclose(exact[name][0, 0], strong, rtol=1e-10)


def test_only_a_concentration_feels_tangential_motion_and_its_own_change(exact):
    for name in ENERGIES:
        _, (tangential, _), (by_concentration, _) = exact[name]
        assert (tangential != 0.0) == (name in OF_A_CONCENTRATION)
        assert (by_concentration != 0.0) == (name in OF_A_CONCENTRATION)


# 2. Discrete against exact.
@pytest.fixture(scope="module")
def rows(bumpy):
    return shape_derivative_rows(bumpy, (1, 2))


@pytest.mark.parametrize("name", ENERGIES)
def test_autodiff_converges_to_the_formula(rows, name):
    """Order 2.8 to 4 between the two meshes; 642 nodes are within 8e-4 of ∫|gV| + |q·∇V|.

    Sliding nodes along the surface changes the mesh alone: what that does has no order to speak of
    on so coarse ones, and is below 1e-4 on the finer.
    """
    directions = ("normal", "tangential", "concentration")
    for direction in directions if name in OF_A_CONCENTRATION else directions[:2]:
        coarse, fine = (
            row["error"] for row in rows if (row["energy"], row["direction"]) == (name, direction)
        )
        assert fine < 8e-4
        small = direction == "tangential" and fine < 1e-4
        assert fine < coarse / 7 or small, (direction, coarse, fine)


@pytest.mark.parametrize("name", ENERGIES)
def test_the_formula_with_recovered_curvature_converges(rows, name):
    """Order 1 in ∇H at the irregular vertices of the mesh, 4 where ∇H does not enter."""
    coarse, fine = (
        row["recovered_error"]
        for row in rows
        if (row["energy"], row["direction"]) == (name, "normal")
    )
    assert fine < 0.5 * coarse and fine < 2e-2


def test_the_willmore_derivative_meets_its_threshold():
    """1e-3 at 642 nodes on an ellipsoid; measured 3.9e-4."""
    row = shape_derivative_rows(verify.triaxial_ellipsoid(), (2,))[0]
    assert (row["energy"], row["direction"]) == ("Willmore", "normal")
    assert abs(row["autodiff"] / row["exact"] - 1) < 1e-3


# 3. The table of formulas.
@pytest.fixture
def somewhere():
    """Geometry at one point, and numbers of the whole."""
    here = verify.Geometry(
        Jet(jnp.asarray(1.3), jnp.array([0.2, -0.1, 0.0])),
        jnp.diag(jnp.array([0.9, 0.4, 0.0])),
        Jet(jnp.asarray(0.5), jnp.zeros(3)),
    )
    whole = verify.Whole(*(jnp.asarray(v) for v in (7.0, 1.5, 9.0)))
    return here, whole


def test_variations_add_like_their_energies(somewhere):
    a, b = Willmore(), CanhamHelfrich(0.6, 0.0, 0.7)
    both = verify.first_variation(2.0 * a + b, *somewhere)
    parts = [verify.first_variation(e, *somewhere) for e in (a, b)]
    np.testing.assert_allclose(both.force, 2 * parts[0].force + parts[1].force, rtol=1e-14)
    np.testing.assert_allclose(both.flux, 2 * parts[0].flux + parts[1].flux, rtol=1e-14)


def test_an_energy_without_a_formula_is_refused(somewhere):
    class Unknown(AbstractEnergy):
        def __call__(self, mesh, x):
            return jnp.zeros(())

    with pytest.raises(ValueError, match="no formula for the first variation of Unknown"):
        verify.first_variation(Unknown(), *somewhere)


def test_what_does_not_hold_is_reported():
    good = {"surface": "s", "energy": "e", "direction": "normal", "exact": 1.0}
    series = [good | {"h": 1.0, "error": 1e-1}, good | {"h": 0.1, "error": 1e-5}]
    identity = {"surface": "s", "identity": "i", "error": 1e-15}
    second = {"mode": 2, "h": 1.0, "exact": 24, "error": 1e-3}
    study = verify.ShapeStudy(series, [identity], [second])
    assert study.failures() == []
    assert "1.0e-01  1.0e-05" in study.text()
    series[1]["error"] = 2e-4
    assert "order 2.70" in study.failures()[0]
    identity["error"], second["error"] = 1e-8, float("nan")
    assert len(study.failures()) == 3


@pytest.mark.slow
def test_the_whole_study_holds():
    assert verify.shape_study().failures() == []

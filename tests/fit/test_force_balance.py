"""Force balance: exact equilibria, scaling, null directions, intervals, refusals."""

import functools as ft

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.fit import force_balance
from jaxwillmore.surface import area, recover_normal, volume

from ..helpers import random_rotation
from .profiles import OBLATE, PROLATE, PROLATE_WITH_H0, equilibrium_nodes


@ft.cache
def oblate(level=1):
    return equilibrium_nodes(*OBLATE, level=level)


def errors(case, level):
    """Relative errors of tension and pressure, absolute error of H0."""
    H0, tension, pressure = case[:3]
    found = force_balance([equilibrium_nodes(*case, level=level)]).parameters[0]
    return np.array(
        [
            found["spontaneous_curvature"] - H0,
            found["tension_over_kappa"] / tension - 1,
            found["pressure_over_kappa"] / pressure - 1,
        ]
    )


def test_an_exact_oblate_tells_its_parameters():
    """Against the shape equations, with 162 nodes; the errors are of order four in h."""
    assert np.all(np.abs(errors(OBLATE, 1)) < [0.9, 0.05, 0.06])


@pytest.mark.slow
@pytest.mark.parametrize("case", [OBLATE, PROLATE, PROLATE_WITH_H0])
def test_exact_equilibria_tell_their_parameters_within_a_percent(case):
    at_642, at_2562 = (np.abs(errors(case, level)) for level in (2, 3))
    assert np.all(at_2562 < 0.01), at_2562
    assert np.all(at_2562 < at_642 / 5), (at_642, at_2562)


def test_parameters_scale_and_ignore_rigid_motion():
    mesh, x = oblate()
    R, size = np.asarray(random_rotation(jr.key(0))), 2.5
    plain = force_balance([(mesh, x)]).parameters[0]
    moved = force_balance([(mesh, size * x @ R.T + [1.0, -2.0, 0.5])]).parameters[0]
    powers = {
        "spontaneous_curvature": 1,
        "effective_tension_over_kappa": 2,
        "tension_over_kappa": 2,
        "pressure_over_kappa": 3,
    }
    for name, power in powers.items():
        np.testing.assert_allclose(moved[name] * size**power, plain[name], rtol=1e-6)


@pytest.mark.parametrize("size", [20.0, 1e-6])  # voxels, m
def test_a_surface_that_is_not_at_rest_has_any_unit(size):
    """In units other than its own, solves inside of derivatives used to end without a solution."""
    mesh, x = meshes.ellipsoid((1.2, 1.2, 0.5), 1, 2)
    plain, other = force_balance([(mesh, x)]), force_balance([(mesh, size * x)])
    for name, power in (("spontaneous_curvature", 1), ("pressure_over_kappa", 3)):
        there = other.parameters[0][name] * size**power
        np.testing.assert_allclose(there, plain.parameters[0][name], rtol=1e-6)
    np.testing.assert_allclose(other.unexplained, plain.unexplained, rtol=1e-6)
    np.testing.assert_allclose(other.residuals[0] / size, plain.residuals[0], atol=1e-6)
    errors = other.identification.standard_errors
    for name, error in plain.identification.standard_errors.items():
        np.testing.assert_allclose(errors[name], error, rtol=1e-6)


def test_known_values_are_taken_and_scale_invariance_ties_the_rest():
    """2σA = 3PV at H0 = 0, an identity of the shape that no fit knows of."""
    mesh, x = oblate()
    found = force_balance([(mesh, x)], known={"spontaneous_curvature": 0.0}).parameters[0]
    assert found["spontaneous_curvature"] == 0.0
    sides = (
        2 * found["tension_over_kappa"] * area(mesh, jnp.asarray(x)),
        volume(mesh, jnp.asarray(x)),
    )
    np.testing.assert_allclose(
        sides[0], 3 * found["pressure_over_kappa"] * sides[1], rtol=1.5e-2
    )  # 162 nodes


def test_a_sphere_tells_nothing_and_says_so():
    """All spheres are equilibria: H0, tension and pressure have the same force on one."""
    mesh, x = meshes.icosphere(1, degree=2)
    found = force_balance([(mesh, x)])
    assert found.identification.rank == 1
    assert all(np.isnan(value) for value in found.parameters[0].values())
    assert not any(found.identification.identifiable.values())
    assert all(np.isinf(error) for error in found.identification.standard_errors.values())
    assert found.unexplained == 0.0 and found.verdict.word == "undetermined"
    words = found.in_words()
    assert words[1].startswith("κ is not identifiable") and len(words) == 4


def test_the_residual_shows_what_no_parameters_explain():
    """Part of an ellipsoid's bending force is balanced by nothing; an equilibrium has none."""
    mesh, x = meshes.ellipsoid((1.0, 1.3, 0.6), 1, 2)
    lost, rest = force_balance([(mesh, x)]), force_balance([oblate()])
    assert lost.unexplained > 0.05 > 5 * rest.unexplained
    assert float(jnp.max(jnp.abs(lost.residuals[0]))) > 0.01
    assert float(jnp.max(jnp.abs(rest.residuals[0]))) < 0.007


def test_surfaces_share_what_is_theirs_together():
    mesh, x = oblate()
    alone = force_balance([(mesh, x)]).parameters[0]
    both = force_balance([(mesh, x), (mesh, 2.0 * x)], known={"spontaneous_curvature": 0.0})
    assert both.identification.names == (
        "scaled_effective_tension[0]",
        "scaled_effective_tension[1]",
        "scaled_pressure[0]",
        "scaled_pressure[1]",
    )
    first, second = both.parameters
    np.testing.assert_allclose(
        first["pressure_over_kappa"], 8 * second["pressure_over_kappa"], rtol=1e-6
    )
    same = force_balance(2 * [(mesh, x)], shared=("spontaneous_curvature", "pressure_over_kappa"))
    np.testing.assert_allclose(
        same.parameters[1]["pressure_over_kappa"], alone["pressure_over_kappa"], rtol=1e-6
    )
    assert len(same.identification.names) == 4


@pytest.mark.slow
def test_intervals_are_as_wide_as_small_noise_makes_them():
    """The covariance is that of the derivative by the nodes; 40 draws give it to 25 %."""
    mesh, x = oblate()
    nu, noise = np.asarray(recover_normal(mesh, jnp.asarray(x))), 1e-6
    at_rest = force_balance([(mesh, x)], noise=noise).identification
    rng = np.random.default_rng(3)
    draws = [
        force_balance([(mesh, x + noise * rng.normal(size=(len(x), 1)) * nu)]).identification.values
        for _ in range(40)
    ]
    spread = np.std(draws, axis=0)
    expected = np.array(list(at_rest.standard_errors.values()))
    assert np.all(np.abs(np.log(spread / expected)) < 0.45), (spread, expected)


MESH, X = meshes.icosphere(0, degree=2)
FLAT = np.asarray(X) * [1.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        ((MESH, np.asarray(X)[::-1] * np.nan), "not finite"),
        ((MESH, np.asarray(X)[:5]), "rows"),
        ((MESH, np.zeros((0, 3))), "shape"),
        ((MESH, np.ones((42, 3))), "flat or a point"),
        ((MESH, FLAT), "flat or a point"),
        ((MESH, -np.asarray(X)), "inside out"),
        (meshes.icosphere(1, degree=1), "degree 1"),
    ],
)
def test_wrong_surfaces_are_refused(surface, message):
    with pytest.raises(ValueError, match=message):
        force_balance([surface])


def test_wrong_questions_are_refused():
    with pytest.raises(ValueError, match="empty"):
        force_balance([])
    with pytest.raises(ValueError, match="`known` has 'bending_modulus'"):
        force_balance([(MESH, X)], known={"bending_modulus": 1.0})
    with pytest.raises(ValueError, match="`shared` has 'tensions'"):
        force_balance([(MESH, X)], shared=("tensions",))

"""The bootstrap over blocks of a residual field: right for independent and for dependent errors."""

import jax
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from jaxwillmore.fit import identify
from jaxwillmore.fit._bootstrap import block_bootstrap, sphere_directions, waves_at
from jaxwillmore.fit._misfit import Harmonics, Points
from jaxwillmore.fit._statistics import patches_of
from jaxwillmore.fit._targets import target
from jaxwillmore.mesh import ellipsoid, icosphere

N = np.asarray(icosphere(3, degree=1)[1])  # 642 points of the unit sphere
FIELD = waves_at(N, np.ones(len(N)), patches_of(N))
WAVES, PATCHES = FIELD
# A long wave and a shorter one, which a fit to a nearly spherical surface knows as parameters;
# size, shift and two turns go along.
OWN = np.stack([WAVES[:, 4] + 0.3 * WAVES[:, 16], 0.1 * WAVES[:, 16] + 0.05 * WAVES[:, 36]], axis=1)
J = np.concatenate([OWN, WAVES[:, [0, 1, 2, 3, 5, 6]]], axis=1)
INVERSE = np.linalg.pinv(J)
INFLUENCE = INVERSE[:2]
DRAWS, TRIALS = 400, 60


@pytest.fixture(autouse=True)
def one_thread():
    """Threads of small matrices wait for each other where the machine has other work."""
    with threadpool_limits(1):
        yield


def variances(errors, seed=0):
    """Mean over trials of the variances of a bootstrap, over those of the errors, and coverage."""
    rng, ratios, inside = np.random.default_rng(seed), [], []
    exact = np.sum((INFLUENCE @ errors) ** 2, axis=1)
    for trial in range(TRIALS):
        e = errors @ rng.normal(size=errors.shape[1])
        moved = INFLUENCE @ e
        r = e - J @ (INVERSE @ e)
        draws = block_bootstrap(r, J, INFLUENCE, [FIELD], draws=DRAWS, seed=trial)
        ratios.append(np.mean(draws**2, axis=0) / exact)
        inside.append(np.abs(moved) <= np.quantile(np.abs(draws), 0.95, axis=0))
    return np.mean(ratios, axis=0), np.mean(inside, axis=0)


def test_independent_errors_give_the_variance_of_least_squares():
    """Above it where a degree has two dimensions left: power that must not rise is not too low."""
    ratio, inside = variances(0.01 * np.eye(len(N)))
    assert 1.0 < ratio[0] < 1.7
    np.testing.assert_allclose(ratio[1], 1.0, atol=0.15)
    assert np.all(inside > 0.9)


def test_errors_that_patches_share_are_as_wide_as_they_are():
    """Equal on each of 64 patches of ten points: up to nine times the variance of independence."""
    errors = 0.01 * (PATCHES[:, None] == np.arange(64)).astype(float)
    plain = 0.01**2 * np.diag(INFLUENCE @ INFLUENCE.T)
    shared = np.sum((INFLUENCE @ errors) ** 2, axis=1)
    assert np.all(shared / plain > 6)
    ratio, inside = variances(errors)
    assert 0.9 < ratio[0] < 1.7
    np.testing.assert_allclose(ratio[1], 1.0, atol=0.2)
    assert np.all(inside > 0.8)


def test_long_waves_of_a_wrong_model_are_seen_as_such():
    """Amplitudes that fall with the degree, as those of smooth surfaces do, whatever patches."""
    degrees = np.floor(np.sqrt(np.arange(81)))
    ratio, _ = variances(0.01 * WAVES * (1 + degrees) ** -1.5)
    np.testing.assert_allclose(ratio, 1.0, atol=0.3)


def test_the_same_seed_draws_the_same_and_nothing_moves_without_residuals():
    r = np.random.default_rng(1).normal(size=len(N))
    draw = lambda seed: block_bootstrap(r, J, INFLUENCE, [FIELD], draws=50, seed=seed)
    assert np.array_equal(draw(3), draw(3)) and not np.array_equal(draw(3), draw(4))
    assert not np.any(block_bootstrap(0 * r, J, INFLUENCE, [FIELD], draws=50))


def test_cells_are_independent_of_each_other():
    """A parameter that two cells share is moved by the mean of what each would do alone."""
    r = np.random.default_rng(1).normal(size=len(N))
    r -= J @ (INVERSE @ r)
    alone = block_bootstrap(r, J, INFLUENCE, [FIELD], draws=4000)
    zero = np.zeros((len(N), 6))
    blocks = [[J[:, :2], J[:, 2:], zero], [J[:, :2], zero, J[:, 2:]]]
    both = np.concatenate([np.concatenate(row, axis=1) for row in blocks])
    influence = np.linalg.pinv(both)[:2]
    drawn = block_bootstrap(np.tile(r, 2), both, influence, [FIELD, FIELD], draws=4000)
    np.testing.assert_allclose(drawn.var(axis=0), 0.5 * alone.var(axis=0), rtol=0.25)


def test_intervals_hold_their_part_of_the_draws():
    found = identify(OWN, ("a", "b"), np.array([1.0, 2.0]), variance=1.0)
    np.testing.assert_allclose(found.influence, np.linalg.pinv(OWN), atol=1e-10)
    draws = np.random.default_rng(0).normal(size=(4000, 2)) * np.array([[0.1, 0.2]])
    low, high = found.with_draws(draws).intervals(0.9)["b"]
    assert np.mean(np.abs(draws[:, 1]) <= 0.5 * (high - low)) == pytest.approx(0.9, abs=1e-3)
    np.testing.assert_allclose((low + high) / 2, 2.0, rtol=1e-12)
    error = found.with_draws(draws).standard_errors["b"]
    np.testing.assert_allclose(error, 0.2, rtol=0.05)


def test_waves_are_those_of_the_sphere_of_which_the_model_is_the_image():
    """Points of an ellipsoid come from the directions that it maps there."""
    axes = np.array([1.0, 1.2, 0.6])
    mesh, x = ellipsoid(tuple(axes), level=1, degree=2)
    n = np.asarray(icosphere(1, degree=2)[1])
    np.testing.assert_allclose(sphere_directions(mesh, x, np.asarray(x)), n, atol=1e-6)
    away = sphere_directions(mesh, x, N * axes)
    assert np.max(np.linalg.norm(away - N, axis=1)) < 0.03


@pytest.mark.parametrize("misfit", [Points(False), Points(True), Harmonics(4)])
def test_fields_have_a_row_for_every_residual(misfit):
    mesh, x = icosphere(1, degree=2)
    seen = target(mesh, 1.1 * x)
    observed = misfit.observe(seen)
    rows = len(jax.eval_shape(lambda x: misfit.rows(observed, mesh, x, x)[0], x))
    (field,) = misfit.fields([seen], [(mesh, x)])
    assert field.waves.shape[0] == len(field.patches) == rows
    # Whole degrees, which are independent at the rows.
    assert round(np.sqrt(field.waves.shape[1])) ** 2 == field.waves.shape[1]
    assert np.linalg.matrix_rank(field.waves) == field.waves.shape[1]

"""Linear statistics of a fit: covariance, null directions in words."""

import numpy as np
import pytest

from jaxwillmore.fit import identify
from jaxwillmore.fit._statistics import laplace, patches_of

RNG = np.random.default_rng(0)
J = RNG.normal(size=(50, 3))
NAMES = ("a", "b", "c")


def test_covariance_and_intervals_are_those_of_linear_regression():
    found = identify(J, NAMES, np.array([1.0, 2.0, 3.0]), variance=0.04)
    exact = 0.04 * np.linalg.inv(J.T @ J)
    np.testing.assert_allclose(found.covariance, exact, rtol=1e-12)
    low, high = found.intervals(0.95)["b"]
    np.testing.assert_allclose((low + high) / 2, 2.0, rtol=1e-12)
    np.testing.assert_allclose(high - low, 2 * 1.959964 * np.sqrt(exact[1, 1]), rtol=1e-6)
    spread = np.sqrt(np.diag(exact))
    np.testing.assert_allclose(found.correlation, exact / np.outer(spread, spread), rtol=1e-12)
    assert found.null_directions == () and all(found.identifiable.values())


def test_a_direction_that_changes_nothing_is_named():
    blind = J.copy()
    blind[:, 2] = blind[:, 1]
    found = identify(blind, NAMES, np.zeros(3))
    assert found.rank == 2
    assert found.identifiable == {"a": True, "b": False, "c": False}
    assert np.isinf(found.standard_errors["b"]) and np.isfinite(found.standard_errors["a"])
    (direction,) = found.null_directions
    np.testing.assert_allclose(abs(direction["b"] - direction["c"]), np.sqrt(2), rtol=1e-9)
    (sentence,) = found.in_words({"b": "the tension"})
    assert sentence == "The combination 0.71 [the tension] -0.71 [c] is not identifiable from " + (
        "these data."
    )


def test_a_parameter_without_any_effect_is_named_alone():
    found = identify(J * [1.0, 0.0, 1.0], NAMES, np.zeros(3))
    assert found.in_words() == ("b is not identifiable from these data.",)


def test_nothing_is_known_from_no_sensitivity():
    assert identify(np.zeros((5, 2)), ("a", "b"), np.zeros(2)).rank == 0


def test_wrong_matrices_are_refused():
    with pytest.raises(ValueError, match="cannot determine"):
        identify(J[:2], NAMES, np.zeros(3))
    with pytest.raises(ValueError, match="not finite"):
        identify(J * np.nan, NAMES, np.zeros(3))
    with pytest.raises(ValueError, match="between 0 and 1"):
        identify(J, NAMES, np.zeros(3)).intervals(95.0)


def test_motion_is_projected_out():
    """The covariance of the named unknowns is the block of the inverse of the whole matrix."""
    r = RNG.normal(size=50)
    found = laplace(r, J, ("a",), np.zeros(1), np.array([2.0]), count=50, variance=1.0)
    np.testing.assert_allclose(found.covariance, 4 * np.linalg.inv(J.T @ J)[:1, :1], rtol=1e-10)


def test_patches_are_equal_in_number_and_compact():
    points = RNG.normal(size=(640, 3))
    number = patches_of(points, levels=4)
    assert np.all(np.bincount(number) == 40)
    spread = [np.ptp(points[number == k], axis=0).min() for k in range(16)]
    assert max(spread) < 0.8 * np.ptp(points, axis=0).min()


@pytest.mark.parametrize(
    ("effect", "options", "told"),
    [
        (1.0, {}, True),
        # Any effect at all, where nothing is asked of it.
        (1e-3, {}, True),
        (1e-3, {"least": 0.1}, False),
        # The standard error of the logarithm is above one here, and below it there.
        (1e-3, {"by_factors": (True,)}, False),
        (0.02, {"by_factors": (True,)}, True),
    ],
)
def test_a_single_parameter_is_told_by_what_it_does(effect, options, told):
    """Its own singular value is the largest there is: relative to that no effect is small."""
    residuals = 0.1 * np.where(np.arange(50) % 2, 1.0, -1.0)
    slopes = np.array([2.0])  # of a positive value, itself: 2 = exp(u)
    J = np.full((50, 1), effect) * slopes
    found = laplace(residuals, J, ("b",), np.array([2.0]), slopes, count=50, **options)
    assert found.identifiable == {"b": told}
    assert np.isfinite(found.standard_errors["b"]) == told

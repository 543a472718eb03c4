"""Step sizes: the controller's rules, and graded starts that keep the order."""

import numpy as np
import pytest

from jaxwillmore.evolve._adaptive import Controller, graded_times, growth_limit

CONTROLLER = Controller(rtol=1e-3)


@pytest.mark.parametrize(
    "error, factor",
    [
        (1e-3, 0.9),  # on the tolerance: a little less, to stay accepted
        (1e-3 / 4, 1.8),  # a quarter of it: √4 · 0.9
        (1e-9, 2.0),  # not faster than the growth that BDF2 stands
        (0.0, 2.0),
        (1.0, 0.5),
    ],
)
def test_the_step_follows_the_error(error, factor):
    assert CONTROLLER.after_acceptance(0.3, error, 2, 3, 0.0) == pytest.approx(0.3 * factor)


def test_the_exponent_is_that_of_the_predictor():
    """Order q extrapolates through max(q, 2) points: an eighth of the error is twice the step."""
    loose = Controller(rtol=1e-3, growth=10.0)
    for order, ratio in ((1, 4.0), (2, 4.0), (3, 8.0), (4, 16.0)):
        found = loose.after_acceptance(1.0, 1e-3 / ratio, order, 3, 0.0)
        assert found == pytest.approx(0.9 * 2.0)


def test_a_hard_nonlinear_solve_stops_the_growth():
    assert CONTROLLER.after_acceptance(0.3, 1e-9, 2, 9, 0.0) == pytest.approx(0.3)
    assert CONTROLLER.after_acceptance(0.3, 1.0, 2, 12, 0.0) == pytest.approx(0.15)


@pytest.mark.parametrize("rise, factor", [(-1.0, 2.0), (1e-7, 2.0), (0.9e-5, 1.0), (1.0, 0.5)])
def test_a_creeping_energy_keeps_the_step_within_its_tolerance(rise, factor):
    """The rise is proportional to the step: the next one may rise by 0.9e-5 of 1e-5."""
    assert CONTROLLER.after_acceptance(0.3, 1e-9, 2, 3, rise) == pytest.approx(0.3 * factor)
    free = Controller(rtol=1e-3, energy_tolerance=np.inf)
    assert free.after_acceptance(0.3, 1e-9, 2, 3, rise) == pytest.approx(0.6)


def test_growth_stays_below_the_stability_limit():
    """Largest constant step ratios of variable-step BDF: 1 + √2, 1.534, 1.280, 1.127."""
    limits = {2: 1 + np.sqrt(2), 3: 1.534, 4: 1.280, 5: 1.127}
    assert all(1 < growth_limit(q) < limit for q, limit in limits.items())


@pytest.mark.parametrize("q", [1, 2, 3, 4, 5])
def test_graded_times_cover_the_interval(q):
    times = np.array(graded_times(0.5, 2.0, 0.01, q, 1.0))
    steps = np.diff(times)
    assert times[0] == 0.5 and times[-1] == 2.0
    assert np.all(steps > 0) and np.max(steps) <= 0.01 * (1 + 1e-12)
    # Steps rise by at most the stable ratio, then all are equal.
    ratios = steps[1:] / steps[:-1]
    n_start = int(np.argmax(steps > 0.999 * steps[-1]))
    np.testing.assert_allclose(steps[n_start:], steps[-1], rtol=1e-9)
    np.testing.assert_allclose(ratios[: max(n_start - 1, 0)], growth_limit(q), rtol=1e-9)
    assert np.all(ratios < growth_limit(q) * (1 + 1e-9))


@pytest.mark.parametrize("q", [2, 3, 4, 5])
def test_the_first_step_has_an_error_of_the_order_of_the_run(q):
    """It is of order 1: its error is step², which must scale like dt^q."""
    first = [np.diff(graded_times(0.0, 1.0, dt, q, 1.0))[0] for dt in (1e-2, 1e-3)]
    assert 2 * np.log10(first[0] / first[1]) == pytest.approx(q, rel=1e-6)


def test_graded_times_scale_with_the_time_scale():
    one = np.array(graded_times(0.0, 1.0, 0.01, 3, 1.0))
    slow = np.array(graded_times(0.0, 16.0, 0.16, 3, 16.0))
    np.testing.assert_allclose(slow, 16 * one, rtol=1e-9)


@pytest.mark.parametrize("dt", [1.0, 0.7, 5.0])
def test_steps_longer_than_the_interval_are_cut(dt):
    for q in (1, 2, 5):
        times = graded_times(0.0, 1.0, dt, q, 0.1)
        assert times[0] == 0.0 and times[-1] == 1.0 and np.all(np.diff(times) > 0)

"""BDF and extrapolation weights: generating polynomials, and exactness on any times."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.evolve._bdf import bdf, extrapolation, padded

ORDERS = (1, 2, 3, 4, 5)


@pytest.mark.parametrize("q", ORDERS)
def test_equal_steps_give_the_generating_polynomials(q):
    """δ(ζ) = Σ_{l≤q} (1 − ζ)^l / l and γ(ζ) = (1 − (1 − ζ)^q) / ζ."""
    zeta = np.polynomial.Polynomial([0.0, 1.0])
    delta = sum((1 - zeta) ** k / k for k in range(1, q + 1))
    gamma = (1 - (1 - zeta) ** q).coef[1:]
    tau = 0.25
    times = 2.0 - tau * jnp.arange(1.0, q + 1)
    np.testing.assert_allclose(bdf(times, jnp.asarray(2.0)), delta.coef / tau, rtol=1e-12)
    np.testing.assert_allclose(extrapolation(times, jnp.asarray(2.0)), gamma, rtol=1e-12)


def uneven_times(q):
    """Newest first, with ratios of neighbouring steps up to 3, and the new time."""
    steps = np.random.default_rng(q).uniform(0.5, 1.5, q + 1)
    times = np.cumsum(steps)[::-1]
    return jnp.asarray(times[1:]), jnp.asarray(times[0])


@pytest.mark.parametrize("q", ORDERS)
def test_polynomials_are_differentiated_and_extrapolated_exactly(q):
    times, t = uneven_times(q)
    for power in range(q + 1):
        values = jnp.concatenate([t[None], times]) ** power
        slope = power * t ** max(power - 1, 0)
        np.testing.assert_allclose(bdf(times, t) @ values, slope, rtol=1e-11, atol=1e-11)
    for power in range(q):
        np.testing.assert_allclose(extrapolation(times, t) @ times**power, t**power, rtol=1e-11)


@pytest.mark.parametrize("q", ORDERS)
def test_the_next_power_is_not_exact(q):
    """The orders are q and q, not more."""
    times, t = uneven_times(q)
    u = lambda s: (s - t) ** (q + 1)
    assert abs(bdf(times, t) @ jnp.concatenate([u(t)[None], u(times)])) > 1e-3
    assert abs(extrapolation(times, t) @ (times - t) ** q) > 1e-3


def test_weights_do_not_see_the_origin_of_time():
    times, t = uneven_times(3)
    np.testing.assert_allclose(bdf(times + 7.0, t + 7.0), bdf(times, t), rtol=1e-12)
    np.testing.assert_allclose(
        extrapolation(times + 7.0, t + 7.0), extrapolation(times, t), rtol=1e-12
    )


@pytest.mark.parametrize("weights", [bdf, extrapolation])
def test_weights_have_derivatives_by_the_times(weights):
    times, t = uneven_times(3)
    slope = jax.jacfwd(weights, argnums=(0, 1))(times, t)
    assert all(bool(jnp.all(jnp.isfinite(s))) for s in slope)
    h = 1e-5
    difference = (weights(times, t + h) - weights(times, t - h)) / (2 * h)
    np.testing.assert_allclose(slope[1], difference, rtol=1e-7, atol=1e-8)


def test_padding_adds_zeros():
    np.testing.assert_array_equal(padded(jnp.array([2.0, -1.0]), 4), [2.0, -1.0, 0.0, 0.0])

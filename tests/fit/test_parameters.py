"""Ranges and poses: inverses, slopes, bounds, rotations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.fit import Between, MatchIterate, Positive, Unbounded, rotation
from jaxwillmore.fit._pose import Pose, aligned

RANGES = [(Unbounded(), -3.0), (Positive(), 0.02), (Between(0.25, 0.997), 0.9)]


@pytest.mark.parametrize(("allowed", "value"), RANGES)
def test_unknown_is_the_inverse_of_value(allowed, value):
    u = jnp.asarray(allowed.unknown(value))
    np.testing.assert_allclose(allowed.value(u), value, rtol=1e-12)
    assert float(jax.grad(allowed.value)(u)) > 0
    assert not allowed.on_bound(value)


def test_an_interval_has_slope_one_half_way_and_cannot_be_left():
    allowed = Between(-10.0, 10.0)
    np.testing.assert_allclose(jax.grad(allowed.value)(jnp.zeros(())), 1.0, rtol=1e-12)
    for u in (-1e3, 1e3):
        value = float(allowed.value(jnp.asarray(u)))
        assert -10.0 <= value <= 10.0 and allowed.on_bound(value)
    with pytest.raises(ValueError, match="between -10 and 10"):
        allowed.unknown(10.0)
    with pytest.raises(ValueError, match="positive"):
        Positive().unknown(0.0)
    with pytest.raises(ValueError, match="in order"):
        Between(1.0, 1.0)


def test_rodrigues_vectors_turn_by_twice_the_arctangent():
    R = np.asarray(rotation(jnp.array([0.0, 0.0, np.tan(0.35)])))
    c, s = np.cos(0.7), np.sin(0.7)
    np.testing.assert_allclose(R, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-14)
    slope = jax.jacfwd(rotation)(jnp.zeros(3))
    # At zero the derivative is twice the cross product, and finite.
    np.testing.assert_allclose(slope[1, 0], [0.0, 0.0, 2.0], atol=1e-14)


def test_motions_compose_with_their_frame():
    x = jnp.asarray(np.random.default_rng(0).normal(size=(5, 3)))
    frame = Pose(rotation(jnp.array([0.1, 0.2, 0.3])), jnp.array([1.0, 2.0, 3.0]), jnp.asarray(2.0))
    motion = jnp.array([0.2, -0.1, 0.3, 0.5, 0.1, -0.2, 0.4])
    moved = frame.moved(motion).place(x, jnp.zeros(7))
    np.testing.assert_allclose(moved, frame.place(x, motion), rtol=1e-12)


def test_principal_axes_find_a_turned_body():
    """One of the four frames is the motion itself; all are rotations."""
    rng = np.random.default_rng(1)
    x = rng.normal(size=(300, 3)) * [3.0, 2.0, 1.0]
    R, b = np.asarray(rotation(jnp.array([0.4, -0.2, 0.3]))), np.array([1.0, -2.0, 0.5])
    ones = np.ones(300)
    poses = aligned(x, ones, 1.5 * x @ R.T + b, ones, 1.5)
    assert len(poses) == 4
    gaps = [
        np.abs(pose.place(jnp.asarray(x), jnp.zeros(7)) - (1.5 * x @ R.T + b)).max()
        for pose in poses
    ]
    assert min(gaps) < 1e-10
    for pose in poses:
        np.testing.assert_allclose(np.linalg.det(pose.axes), 1.0, rtol=1e-12)


@pytest.mark.parametrize(
    "tables", [{}, {"parameters": [{}], "poses": []}, {"parameters": [{"a": "b"}], "poses": [{}]}]
)
def test_what_is_no_iterate_is_refused(tables):
    with pytest.raises(ValueError, match="no iterate"):
        MatchIterate.from_json(tables)

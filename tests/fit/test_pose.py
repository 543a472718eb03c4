"""Poses: turned, scaled and moved, and back."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np

from jaxwillmore.fit._pose import Pose, rotation

POSE = Pose(rotation(jnp.array([0.2, -0.1, 0.3])), jnp.array([1.0, 2.0, 3.0]), jnp.asarray(1.7))
MOTION = jnp.array([0.3, -0.2, 0.5, 0.1, 0.2, -0.3, 0.4])
X = jr.normal(jr.key(0), (20, 3))


def test_back_undoes_place():
    np.testing.assert_allclose(POSE.back(POSE.place(X, MOTION), MOTION), X, atol=1e-12)


def test_a_motion_may_become_the_frame():
    still = jnp.zeros(7)
    np.testing.assert_allclose(
        POSE.moved(MOTION).place(X, still), POSE.place(X, MOTION), atol=1e-12
    )

"""Anderson's mixing on linear iterations, whose ends are known."""

import numpy as np

from jaxwillmore.linalg._mixing import mixed


def test_mixing_ends_a_linear_iteration_in_as_many_steps_as_it_has_directions():
    """y ← y - d with an affine d of rank two: exact after two differences."""
    rng = np.random.default_rng(0)
    U = rng.normal(size=(30, 2))
    A = np.eye(30) + U @ rng.normal(size=(2, 30)) / 5
    b, y, past = rng.normal(size=30), np.zeros(30), ()
    for _ in range(4):
        d = A @ y - b
        y, past = y - mixed(past, y, d), (*past, (y, d))
    np.testing.assert_allclose(y, np.linalg.solve(A, b), atol=1e-10)


def test_without_a_past_or_any_change_the_correction_is_itself():
    y, d = np.zeros(3), np.ones(3)
    assert mixed((), y, d) is d
    np.testing.assert_array_equal(mixed(((y, d),), y, d), d)


def test_nearly_parallel_directions_do_not_blow_up():
    """A past along one direction, up to rounding: what is mixed in stays of the size of y."""
    rng = np.random.default_rng(1)
    direction, b = rng.normal(size=20), rng.normal(size=20)
    past, y = (), np.zeros(20)
    for k in range(4):
        d = (0.5**k) * direction * (1 + 1e-15 * rng.normal(size=20))
        past, y = (*past, (y, d)), y - d
    step = mixed(past, y, b)
    assert np.linalg.norm(step) < 10 * (np.linalg.norm(b) + np.linalg.norm(direction))

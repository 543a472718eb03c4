"""A correction that goes astray is halved, without a warning on the way."""

import numpy as np

from jaxwillmore.linalg._damping import damped


def test_a_step_whose_residual_overflows_when_squared_is_halved():
    """exp(y) = 1 from y = -8: the first tries end where the residual is above 1e200."""
    residual = lambda y: np.expm1(y)
    y, d = np.array([-8.0]), np.array([-500.0])
    found = damped(residual, y, residual(y), d, 60.0)
    assert found.tried > 2 and np.all(np.isfinite(found.f))
    assert not found.accepted or np.abs(found.f[0]) < np.abs(residual(y)[0])

"""Motions from outside: what holds the drift, and nodes on a given path."""

import jax.numpy as jnp
import numpy as np

from jaxwillmore.flows import GivenMotion, NoDrift, System, WillmoreFlow
from jaxwillmore.mesh import icosphere

from .systems import whole


def test_the_drift_is_the_integral_of_the_normal_velocity():
    """∫ V ν on the sphere of radius 2: for V = 3a·ν it is 16π a, over V R² to be of order one."""
    mesh, x = icosphere(1, 2, 2.0)
    flow, nu = System(WillmoreFlow(), NoDrift()), x / 2
    a = jnp.array([0.3, -0.2, 0.5])
    state = whole(flow, mesh, x, {"V": 3 * nu @ a, "nu": nu}, multipliers=jnp.zeros(3))
    units = state.units
    expected = 16 * np.pi * a / (units.velocity * units.length**2)
    np.testing.assert_allclose(flow.closures(state), expected, rtol=3e-3)  # 162 nodes
    still = whole(flow, mesh, x, {"V": 1 + 0 * nu[:, 0], "nu": nu}, multipliers=jnp.zeros(3))
    np.testing.assert_allclose(flow.closures(still), 0.0, atol=1e-12)


def test_nodes_are_where_their_path_is():
    mesh, x = icosphere(0, 1)
    flow = System(GivenMotion(lambda t, p: (1 + t) * p, x))
    found = flow.position(jnp.asarray(0.5), jnp.zeros_like(x))
    np.testing.assert_allclose(found, 1.5 * x, rtol=1e-15)
    assert not flow.moves and mesh.n_nodes == len(found)

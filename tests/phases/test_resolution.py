"""What a mesh can carry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.mesh import icosphere
from jaxwillmore.phases import REFUSE_BELOW, WARN_BELOW, checked_width, resolution


def test_the_resolution_is_the_width_over_the_distance_of_nodes():
    """h = √(4π/642) on the unit sphere; it does not see units."""
    mesh, x = icosphere(2, 2)
    np.testing.assert_allclose(
        resolution(mesh, x, 0.15), 0.15 / np.sqrt(4 * np.pi / 642), rtol=1e-4
    )
    np.testing.assert_allclose(resolution(mesh, 3 * x, 0.45), resolution(mesh, x, 0.15), rtol=1e-13)


def test_an_interface_thinner_than_the_mesh_is_refused_with_what_is_allowed():
    mesh, x = icosphere(1, 2)
    h = 1 / float(resolution(mesh, x, 1.0))
    assert REFUSE_BELOW < WARN_BELOW
    assert checked_width(mesh, x, 1.001 * REFUSE_BELOW * h) == 1.001 * REFUSE_BELOW * h
    for width in (0.999 * REFUSE_BELOW * h, 0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match=r"at least 0.4 h = 0.111.*h = 0.278"):
            checked_width(mesh, x, width)


def test_a_traced_width_passes():
    mesh, x = icosphere(0, 2)
    assert jax.jit(lambda w: checked_width(mesh, x, w))(jnp.asarray(1e-3)) == 1e-3

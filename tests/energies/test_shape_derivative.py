"""The shape derivative: exact on polynomials, equal to the gradient, checked arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import Pressure, SurfaceTension, shape_derivative
from jaxwillmore.mesh import icosphere
from jaxwillmore.surface import centroid, volume

MESH, X = icosphere(0, degree=1)


def test_volume_grows_by_three_times_itself_when_scaled():
    np.testing.assert_allclose(
        shape_derivative(volume, MESH, X, X), 3 * volume(MESH, X), rtol=1e-13
    )


def test_it_is_the_gradient_times_the_direction():
    energy = SurfaceTension(0.7) + Pressure(0.4)
    direction = jnp.sin(3 * X + 0.2)
    gradient = jax.grad(lambda x: energy(MESH, x))(X)
    found = shape_derivative(energy, MESH, X, direction)
    np.testing.assert_allclose(found, jnp.vdot(gradient, direction), rtol=1e-12)


def test_vectors_have_one_too():
    """The centroid moves with the surface."""
    shift = jnp.broadcast_to(jnp.array([[1.0, -2.0, 0.5]]), X.shape)
    np.testing.assert_allclose(shape_derivative(centroid, MESH, X, shift), shift[0], atol=1e-13)


def test_a_direction_of_the_wrong_shape_is_refused():
    with pytest.raises(ValueError, match=r"one vector per node, shape \(12, 3\)"):
        shape_derivative(volume, MESH, X, X[:5])

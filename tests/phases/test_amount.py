"""The amount of a phase: exact for a constant, linear, conserved numbers of the weak form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.fem import load
from jaxwillmore.mesh import ellipsoid, icosphere
from jaxwillmore.phases import amount, with_mean
from jaxwillmore.surface import area


def test_the_amount_is_the_sum_of_the_loads_of_a_weak_form():
    """∫c = Σ_i (c, φ_i), because the basis sums to one: what a conservative step conserves."""
    mesh, x = ellipsoid((1.0, 1.2, 1.5), 0, 2)
    c = jnp.sin(3 * x[:, 0]) + x[:, 2] ** 2
    loads = load(mesh, x, lambda _, f, phi, __: f.c.value * phi, {"c": c})
    np.testing.assert_allclose(amount(mesh, x, c), jnp.sum(loads), rtol=1e-13)


def test_the_amount_of_a_constant_is_its_area():
    """To the difference of two quadrature rules on 162 nodes."""
    mesh, x = icosphere(1, 2)
    found = amount(mesh, x, jnp.full(mesh.n_nodes, 0.3))
    np.testing.assert_allclose(found, 0.3 * area(mesh, x), rtol=1e-5)


def test_a_given_mean_is_met_to_rounding_and_gradients_stay():
    mesh, x = ellipsoid((1.0, 1.2, 1.5), 0, 2)
    c = 0.4 * x[:, 0] * x[:, 1]
    shifted = with_mean(mesh, x, c, 0.37)
    mean = amount(mesh, x, shifted) / area(mesh, x)
    np.testing.assert_allclose(mean, 0.37, rtol=1e-14)
    np.testing.assert_allclose(shifted - c, (shifted - c)[0], rtol=1e-12)


def test_the_mean_may_be_a_parameter():
    mesh, x = icosphere(0, 2)
    slope = jax.jacfwd(lambda mean: with_mean(mesh, x, x[:, 2], mean))(jnp.asarray(0.4))
    np.testing.assert_allclose(slope, slope[0], rtol=1e-14)
    # One, but for the two rules that see the area of 42 nodes.
    np.testing.assert_allclose(slope[0], 1.0, rtol=1e-3)


@pytest.mark.parametrize("mean", [0.0, 1.0, -0.1, 1.5, float("nan")])
def test_a_mean_outside_of_the_surface_is_refused(mean):
    mesh, x = icosphere(0, 2)
    with pytest.raises(ValueError, match="`mean` must lie between 0 and 1"):
        with_mean(mesh, x, x[:, 2], mean)

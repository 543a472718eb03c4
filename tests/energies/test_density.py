"""Densities that a user writes: what they see, closed forms, bad shapes.

The meshes of 162 nodes err by 1e-3 in the area and by 3e-3 in moments.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import CanhamHelfrich, Density, ExternalPotential, Willmore
from jaxwillmore.mesh import icosphere


@pytest.fixture(scope="module")
def sphere():
    return icosphere(1, 2, radius=2.0)


def test_a_density_sees_the_geometry_of_a_sphere(sphere):
    """R = 2: |position|² = 4, normal = position/2, H = 1, K = 1/4; area 16π."""
    mesh, x = sphere

    def density(p, f):
        straight = jnp.dot(p.position, p.normal)
        return jnp.dot(p.position, p.position) + 10 * straight + 100 * p.H + 1000 * p.K

    expected = 16 * np.pi * (4 + 20 + 100 + 250)
    np.testing.assert_allclose(Density(density)(mesh, x), expected, rtol=5e-3)


def test_a_density_sees_values_and_gradients_of_fields(sphere):
    """∫|∇z|² = (2/3)·16π for z = x₃; a vector field keeps its components; any name will do."""
    mesh, x = sphere
    fields = {"Y": x[:, 2], "v": x}
    density = lambda p, f: jnp.sum(f.Y.grad**2) + 3 * f.v.value[0] ** 2
    # ∫x₁² = 4/3 · 16π.
    expected = 16 * np.pi * (2 / 3 + 4)
    np.testing.assert_allclose(Density(density, fields)(mesh, x), expected, rtol=5e-3)


def test_an_external_potential_is_integrated(sphere):
    mesh, x = sphere
    found = ExternalPotential(lambda p: p[2] ** 2 + p[0])(mesh, x)
    np.testing.assert_allclose(found, 16 * np.pi * 4 / 3, rtol=5e-3)


def test_the_known_energies_as_densities(sphere):
    """K comes as in `CanhamHelfrich`, H as its normal part Y·n: |Y|² differs by the error of n."""
    mesh, x = sphere
    x = x * jnp.array([[1.0, 1.2, 1.5]])
    b_k = 1 + x[:, 0]
    total = CanhamHelfrich(0.5, b_k) + -1.0 * Willmore()
    density = Density(lambda p, f: f.b_k.value * p.K, {"b_k": b_k})
    # Up to the quadrature of the product of two nodal fields.
    np.testing.assert_allclose(density(mesh, x), total(mesh, x), rtol=1e-4)
    found = Density(lambda p, f: 0.5 * p.H**2)(mesh, x)
    np.testing.assert_allclose(found, Willmore()(mesh, x), rtol=1e-2)


class Spring(eqx.Module):
    """A potential with a parameter to fit."""

    stiffness: jax.Array

    def __call__(self, p):
        return 0.5 * self.stiffness * jnp.dot(p, p)


def test_parameters_of_a_user_are_parameters(sphere):
    """dE/dk = ∫½|x|² = 32π, and energies of all kinds add and scale."""
    mesh, x = sphere
    energy = Density(lambda p, f: jnp.ones(())) + 2.0 * ExternalPotential(Spring(jnp.asarray(3.0)))
    slope = eqx.filter_grad(lambda energy: energy(mesh, x))(energy)
    potential = slope.terms[1].terms[0].potential
    np.testing.assert_allclose(potential.stiffness, 2 * 32 * np.pi, rtol=5e-3)
    np.testing.assert_allclose(energy(mesh, x), 16 * np.pi * (1 + 2 * 6), rtol=5e-3)


def test_wrong_shapes_are_named(sphere):
    mesh, x = sphere
    with pytest.raises(ValueError, match="`potential` must return one number; got shape \\(3,\\)"):
        ExternalPotential(lambda p: p)(mesh, x)
    with pytest.raises(ValueError, match="`density` must return one number; got shape \\(3,\\)"):
        Density(lambda p, f: p.normal)(mesh, x)
    with pytest.raises(ValueError, match="The field `c` needs shape \\(162,\\)"):
        Density(lambda p, f: f.c.value, {"c": np.ones(5)})(mesh, x)

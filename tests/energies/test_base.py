"""The algebra of energies: sums and multiples are what they say, and stay differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import AbstractEnergy
from jaxwillmore.mesh import icosphere
from jaxwillmore.surface import area, volume


class Area(AbstractEnergy):
    def __call__(self, mesh, x):
        return area(mesh, x)


class Volume(AbstractEnergy):
    def __call__(self, mesh, x):
        return volume(mesh, x)


def test_energies_add_and_scale():
    mesh, x = icosphere(0, 1)
    A, V = area(mesh, x), volume(mesh, x)
    for energy, expected in (
        (Area() + Volume(), A + V),
        (2.0 * Area() + Volume() * 3, 2 * A + 3 * V),
        (0.5 * (Area() + 4 * Volume()), 0.5 * A + 2 * V),
        (Area() + -1 * Area(), 0.0 * A),
        (sum([Volume(), Volume()], start=Area()), A + 2 * V),
    ):
        assert isinstance(energy, AbstractEnergy)
        np.testing.assert_allclose(energy(mesh, x), expected, rtol=1e-14, atol=1e-14)


def test_factors_are_parameters_to_fit():
    mesh, x = icosphere(0, 1)
    slope = jax.grad(lambda c: (c * Area() + Volume())(mesh, x))(jnp.asarray(2.0))
    np.testing.assert_allclose(slope, area(mesh, x), rtol=1e-14)
    leaves = jax.tree.leaves(2.0 * Area())
    assert len(leaves) == 1 and leaves[0].dtype == jnp.float64


def test_an_energy_adds_to_energies_only():
    with pytest.raises(TypeError):
        Area() + 1.0
    with pytest.raises(TypeError):
        Area() * Volume()


def test_an_energy_must_say_what_it_is():
    with pytest.raises(TypeError):
        AbstractEnergy()

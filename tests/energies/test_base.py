"""The algebra of energies: sums and multiples are what they say, and stay differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import AbstractEnergy
from jaxwillmore.mesh import icosphere


class Moment(AbstractEnergy):
    """Cheap to evaluate: the algebra does not ask what an energy means."""

    def __call__(self, mesh, x):
        return jnp.sum(x**2)


class Height(AbstractEnergy):
    def __call__(self, mesh, x):
        return jnp.sum(x[:, 2] ** 4)


def test_energies_add_and_scale():
    mesh, x = icosphere(0, 1)
    A, V = Moment()(mesh, x), Height()(mesh, x)
    for energy, expected in (
        (Moment() + Height(), A + V),
        (2.0 * Moment() + Height() * 3, 2 * A + 3 * V),
        (0.5 * (Moment() + 4 * Height()), 0.5 * A + 2 * V),
        (Moment() + -1 * Moment(), 0.0 * A),
        (sum([Height(), Height()], start=Moment()), A + 2 * V),
    ):
        assert isinstance(energy, AbstractEnergy)
        np.testing.assert_allclose(energy(mesh, x), expected, rtol=1e-14, atol=1e-14)


def test_factors_are_parameters_to_fit():
    mesh, x = icosphere(0, 1)
    slope = jax.grad(lambda c: (c * Moment() + Height())(mesh, x))(jnp.asarray(2.0))
    np.testing.assert_allclose(slope, jnp.sum(x**2), rtol=1e-14)
    leaves = jax.tree.leaves(2.0 * Moment())
    assert len(leaves) == 1 and leaves[0].dtype == jnp.float64


def test_an_energy_adds_to_energies_only():
    with pytest.raises(TypeError):
        Moment() + 1.0
    with pytest.raises(TypeError):
        Moment() * Height()


def test_an_energy_must_say_what_it_is():
    with pytest.raises(TypeError):
        AbstractEnergy()

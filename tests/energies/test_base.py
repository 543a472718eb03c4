"""The algebra of energies: sums and multiples are what they say, and stay differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import (
    AbstractEnergy,
    CanhamHelfrich,
    Density,
    ExternalPotential,
    FreeEnergy,
    GinzburgLandau,
    Mixture,
    SurfaceTension,
    TwoPhase,
    Willmore,
    shape_derivative,
)
from jaxwillmore.mesh import SurfaceMesh, icosphere


class Moment(AbstractEnergy):
    """Cheap to evaluate: the algebra does not ask what an energy means."""

    def __call__(self, mesh, x, fields=None):
        return jnp.sum(x**2)


class Height(AbstractEnergy):
    def __call__(self, mesh, x, fields=None):
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
        (sum([Moment(), Height()]), A + V),
        (-Moment(), -A),
        (Moment() - Height(), A - V),
        (Moment() / 2 - Height() / jnp.asarray(4.0), A / 2 - V / 4),
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
        1.0 + Moment()
    with pytest.raises(TypeError):
        Moment() - 1.0
    with pytest.raises(TypeError):
        Moment() * Height()
    with pytest.raises(TypeError):
        Moment() / Height()


def test_an_energy_must_say_what_it_is():
    with pytest.raises(TypeError):
        AbstractEnergy()


# What every energy does with its arguments.


class Load(AbstractEnergy):
    """Reads a field of the moment."""

    def __call__(self, mesh, x, fields=None):
        assert fields is not None
        return jnp.vdot(fields["q"], x[:, 2])


def test_a_sum_hands_the_fields_of_the_moment_to_every_term():
    mesh, x = icosphere(0, 1)
    q = x[:, 0] + 2.0
    total = 2.0 * Load() - Moment()
    expected = 2 * jnp.vdot(q, x[:, 2]) - jnp.sum(x**2)
    np.testing.assert_allclose(total(mesh, x, {"q": q}), expected, rtol=1e-14)
    slope = shape_derivative(total, mesh, x, x, {"q": q})
    np.testing.assert_allclose(slope, expected - jnp.sum(x**2), rtol=1e-14)


def test_the_scale_of_a_sum_is_that_of_its_terms_though_they_cancel():
    mesh, x = icosphere(0, 1)
    energy = Moment() - 0.5 * Moment() + -0.5 * Moment()
    np.testing.assert_allclose(energy(mesh, x), 0.0, atol=1e-14)
    np.testing.assert_allclose(energy.scale(mesh, x), 2 * jnp.sum(x**2), rtol=1e-14)


ENERGIES = (
    Willmore(),
    CanhamHelfrich(0.5, 0.1, 0.3),
    ExternalPotential(lambda p: p[2] ** 2),
    Density(lambda p, f: p.position[2] ** 2 + f.c.value),
    SurfaceTension(2.0),
    GinzburgLandau(1.0, 0.5),
    FreeEnergy(lambda u: u**2),
    TwoPhase(Mixture(0.5, 1.0), line_tension=1.0, interface_width=0.5),
)
OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


@pytest.fixture(scope="module")
def octahedron():
    up = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4)]
    return SurfaceMesh(np.array(up + [(b, a, 5) for a, b, _ in up]), 1, 6)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: type(e).__name__)
def test_integers_are_numbers_and_short_floats_are_not(octahedron, energy):
    """Nodes in float32 have lost the digits that second derivatives need."""
    x = jnp.asarray(OCTAHEDRON, float)
    c = jnp.linspace(0.0, 1.0, 6)
    fields = {"c": c, "u": c}
    expected = energy(octahedron, x, fields)
    np.testing.assert_array_equal(energy(octahedron, OCTAHEDRON, fields), expected)
    for short in (jnp.float32, jnp.float16):
        with pytest.raises(ValueError, match=f"`x` must hold 64-bit floats; got {short.__name__}"):
            energy(octahedron, x.astype(short), fields)
    with pytest.raises(ValueError, match=r"`x` needs shape \(6, 3\)"):
        energy(octahedron, x[:5], fields)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: type(e).__name__)
def test_every_energy_has_a_scale_not_below_its_value(octahedron, energy):
    x = jnp.asarray(OCTAHEDRON, float)
    c = jnp.linspace(-0.1, 1.1, 6)
    fields = {"c": c, "u": c}
    value = energy(octahedron, x, fields)
    gauss = 4 * np.pi * 0.1 if isinstance(energy, CanhamHelfrich) else 0.0  # a constant
    assert energy.scale(octahedron, x, fields) >= (jnp.abs(value) - gauss) * (1 - 1e-14)

"""Equilibria under energies of the whole surface: laws, equivalences, derivatives, refusals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import equilibria, mesh as meshes
from jaxwillmore.energies import (
    AbstractGlobalEnergy,
    AreaDifference,
    CanhamHelfrich,
    OsmoticPressure,
    Willmore,
)

B, RT, AMBIENT, THICKNESS = 0.7, 3.0, 2.0, 0.01


def energy(n, kappa_r, difference):
    """The sum of all tests: one structure, so that Newton's method is compiled once."""
    osmotic = OsmoticPressure(n, AMBIENT, temperature=1.5, gas_constant=1.0, vant_hoff_index=2.0)
    return CanhamHelfrich(B) + osmotic + AreaDifference(kappa_r, difference, THICKNESS)


@pytest.fixture(scope="module")
def swollen(prolate):
    """Area held, volume by osmosis: the solute that holds the prolate of v = 0.8 open."""
    volume = float(prolate.parameters.volume)
    n = volume * (AMBIENT + float(prolate.pressure) / RT)
    return equilibria.equilibrium(prolate.mesh, prolate.x, energy(n, 1e-9, 0.0))


@pytest.fixture(scope="module")
def bilayer(prolate):
    """Area and volume held, with an area difference that the prolate does not have."""
    difference = 1.1 * THICKNESS * float(prolate.total_mean_curvature)
    return equilibria.equilibrium(
        prolate.mesh, prolate.x, energy(1.0, 2.0, difference), reduced_volume=0.8
    )


def constants(shape):
    """Solute, ambient concentration, nonlocal modulus, preferred difference."""
    osmotic, difference = (term.terms[0] for term in shape.parameters.global_energy.terms)
    return (
        osmotic.solute_amount,
        osmotic.ambient_concentration,
        difference.nonlocal_modulus,
        difference.preferred_difference,
    )


def test_osmotic_pressure_obeys_vant_hoff(swollen):
    n, ambient, _, _ = constants(swollen)
    volume = swollen.parameters.volume
    np.testing.assert_allclose(swollen.pressure, RT * (n / volume - ambient), rtol=1e-9)
    assert swollen.succeeded and swollen.residual < 1e-9
    # Another path to the shape ends on a slightly different reference mesh.
    np.testing.assert_allclose(swollen.reduced_volume, 0.8, rtol=1e-6)


def test_osmosis_holds_the_shape_that_a_held_volume_holds(swollen):
    volume = float(swollen.parameters.volume)
    held = equilibria.equilibrium(swollen.mesh, swollen.x, energy(1.0, 1e-9, 0.0), volume=volume)
    np.testing.assert_allclose(held.pressure, swollen.pressure, rtol=1e-6)
    np.testing.assert_allclose(held.energy, swollen.energy, rtol=1e-8)
    # A volume that may vary can only lower the eigenvalues.
    assert swollen.eigenvalues[0] <= held.eigenvalues[0] + 1e-5


def test_area_difference_acts_as_a_spontaneous_curvature(bilayer):
    _, _, kappa_r, difference = constants(bilayer)
    M, A = bilayer.total_mean_curvature, bilayer.parameters.area
    slope = kappa_r * np.pi / (A * THICKNESS) * (THICKNESS * M - difference)
    np.testing.assert_allclose(bilayer.curvature_multiplier, slope, rtol=1e-8)
    H0 = float(bilayer.effective_spontaneous_curvature)
    np.testing.assert_allclose(H0, -slope / (2 * B), rtol=1e-12)
    assert abs(H0) > 0.05
    # Written as a sum of the same structure, with H0 in place of the area difference.
    osmotic = bilayer.parameters.global_energy.terms[0]
    alike = CanhamHelfrich(B, 0.0, H0) + osmotic + AreaDifference(1e-12, 0.0, THICKNESS)
    same = equilibria.equilibrium(bilayer.mesh, bilayer.x, alike, reduced_volume=0.8)
    np.testing.assert_allclose(same.x, bilayer.x, atol=5e-6)
    np.testing.assert_allclose(same.pressure, bilayer.pressure, rtol=1e-5)
    # The tensions differ by b (H0² − 0²), the term of the square that the area carries.
    np.testing.assert_allclose(same.tension + B * H0**2, bilayer.tension, rtol=1e-5)


def test_total_mean_curvature_is_the_integral_of_H(bilayer):
    class Total(AbstractGlobalEnergy):
        def of(self, A, V_p, M):
            return M

    M = Total()(bilayer.mesh, bilayer.x)
    # The weak mean curvature of the nodes instead of the mixed field: 4e-4 apart on 162 nodes.
    np.testing.assert_allclose(bilayer.total_mean_curvature, M, rtol=1e-3)


@pytest.fixture(scope="module")
def outputs(swollen):
    """Total energy and a mixture of shape and multipliers by the four constants."""

    def where(p):
        osmotic, difference = (term.terms[0] for term in p.global_energy.terms)
        return (
            osmotic.solute_amount,
            osmotic.ambient_concentration,
            difference.nonlocal_modulus,
            difference.preferred_difference,
        )

    @jax.jit
    def of(values):
        found = equilibria.resolve(swollen, eqx.tree_at(where, swollen.parameters, tuple(values)))
        mixture = jnp.max(found.x[:, 2]) + found.pressure + found.curvature_multiplier
        return jnp.stack([found.energy + found.global_energy, mixture, found.volume])

    n, ambient, _, _ = constants(swollen)
    difference = 0.9 * THICKNESS * swollen.total_mean_curvature
    return of, jnp.stack([n, ambient, jnp.asarray(0.4), difference])


@pytest.fixture(scope="module")
def jacobian(outputs):
    of, values = outputs
    _, pull = jax.vjp(of, values)
    return np.stack([pull(jnp.array(row))[0] for row in np.eye(3)])


@pytest.mark.slow
@pytest.mark.parametrize("k", range(4), ids=["solute", "ambient", "nonlocal", "difference"])
def test_derivatives_by_the_constants_agree_with_differences(outputs, jacobian, k):
    of, values = outputs
    h = 1e-4 * float(values[k])
    unit = jnp.zeros(4).at[k].set(h)
    difference = (of(values + unit) - of(values - unit)) / (2 * h)
    np.testing.assert_allclose(jacobian[:, k], difference, rtol=1e-5)


@pytest.mark.slow
def test_forward_mode_agrees_with_reverse_mode(outputs, jacobian):
    of, values = outputs
    np.testing.assert_allclose(jax.jacfwd(of)(values), jacobian, rtol=1e-7)


def test_the_total_energy_is_stationary(outputs, jacobian):
    """Its derivative by the ambient concentration is the explicit one: iRT (V − n/c̄)."""
    of, values = outputs
    n, ambient, _, _ = values
    np.testing.assert_allclose(jacobian[0, 1], RT * (of(values)[2] - n / ambient), rtol=1e-7)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"energy": Willmore() + CanhamHelfrich()}, "one bending energy"),
        ({"energy": Willmore(), "bending_modulus": 1.0}, "leave out `bending_modulus`"),
        ({"energy": -1.0 * Willmore()}, "positive"),
    ],
)
def test_sums_that_mean_nothing_are_refused(arguments, message):
    mesh, x = meshes.icosphere(1, degree=2)
    with pytest.raises(ValueError, match=message):
        equilibria.equilibrium(mesh, x, **arguments)

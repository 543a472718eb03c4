"""Equilibria of two phases by way of others: branches, finer meshes, all their parameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore import equilibria
from jaxwillmore.energies import Mixture, TwoPhase
from jaxwillmore.equilibria._equilibrium import Relaxation

WIDTH = 0.6


def energy():
    moduli = Mixture(0.5, 0.6), Mixture(0.0, 0.4), Mixture(-0.2, 0.1)
    return TwoPhase(*moduli, line_tension=2.0, interface_width=WIDTH)


@pytest.fixture(scope="module")
def halves():
    """42 nodes, in units that are not one."""
    mesh, x = equilibria.spheroid(0.85, level=0)
    c = jw.phases.stripe(mesh, 1.3 * x, WIDTH)
    return equilibria.equilibrium(mesh, 1.3 * x, energy(), c=c, mean=0.5, reduced_volume=0.85)


def where(p):
    bending, well = p.two_phase.bending, p.two_phase.mixing.well
    moduli = bending.bending_modulus, bending.spontaneous_curvature, bending.gaussian_modulus
    ends = [(modulus.at_zero, modulus.at_one) for modulus in moduli]
    return (*sum(ends, ()), well.line_tension, well.interface_width, p.area, p.volume, p.amount)


def test_the_energy_changes_with_every_parameter_as_at_the_shape_it_has(halves):
    """The envelope theorem; by area, volume and amount the slopes are the multipliers."""

    @eqx.filter_jit
    @jax.grad
    def slopes(values):
        p = eqx.tree_at(where, halves.parameters, tuple(values))
        return equilibria.resolve(halves, p).total_energy

    @eqx.filter_jit
    @jax.grad
    def explicit(values):
        p = halves.units.parameters(eqx.tree_at(where, halves.parameters, tuple(values)))
        system = Relaxation(halves.mesh, (True, True), 1e-10, "direct")
        parts = system.system(halves.reference, p).energies(halves.unknowns)
        return halves.units.kappa * parts.total

    values = jnp.stack(where(halves.parameters))
    multipliers = [-halves.tension, halves.pressure, halves.chemical_potential]
    expected = [*explicit(values)[:-3], *multipliers]
    # What the soft rigid constraints store, 6e-6 on so coarse a mesh, is not in the energy.
    np.testing.assert_allclose(slopes(values), jnp.stack(expected), rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("parameter, stop", [("line_tension", 2.4), ("mean", 0.46)])
def test_the_slope_of_the_energy_along_a_branch_is_that_of_the_envelope_theorem(
    halves, parameter, stop
):
    found = equilibria.branch(halves, parameter, stop=stop, step0=abs(stop - 0.5 * (stop > 1)) / 8)
    assert found.succeeded
    rows, last = found.rows, found.points[-1]
    np.testing.assert_allclose(rows[-1][parameter], stop, rtol=1e-12)
    if parameter == "mean":
        np.testing.assert_allclose(rows[-1]["mean"], stop, rtol=1e-10)
        slopes = [row["chemical_potential"] * float(last.parameters.area) for row in rows]
    else:
        slopes = [row["mixing_energy"] / row["line_tension"] for row in rows]
    for k in range(len(rows) - 1):
        run = rows[k + 1][parameter] - rows[k][parameter]
        rise = rows[k + 1]["total_energy"] - rows[k]["total_energy"]
        # The trapezoidal rule, and the change of discretisation error between references.
        assert rise == pytest.approx(0.5 * (slopes[k] + slopes[k + 1]) * run, abs=3e-2 * abs(rise))


def test_a_branch_in_the_reduced_volume_carries_both_phases_along(halves):
    found = equilibria.branch(halves, stop=0.83)
    assert found.succeeded
    np.testing.assert_allclose(found.rows[-1]["mean"], 0.5, rtol=1e-10)
    assert found.rows[-1]["negative_directions"] == 0


def test_a_finer_mesh_starts_from_the_coarse_concentration(halves):
    fine = equilibria.refined(halves, stability=False)
    assert fine.succeeded and fine.mesh.n_nodes == 162 and fine.stats["outer_steps"] == 0
    assert fine.mean_concentration is not None
    np.testing.assert_allclose(fine.mean_concentration, 0.5, rtol=1e-10)
    np.testing.assert_allclose(fine.total_energy, halves.total_energy, rtol=0.05)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"parameter": "mean", "stop": 1.5}, r"\(0, 1\)"),
        ({"parameter": "line_tension", "stop": -1.0}, "positive"),
        ({"parameter": "spontaneous_curvature", "stop": 1.0}, "one phase"),
        ({"parameter": "interface_width", "stop": 0.01}, "width"),
    ],
)
def test_branches_that_cannot_be_are_refused(halves, arguments, message):
    with pytest.raises(ValueError, match=message):
        equilibria.branch(halves, **arguments)


@pytest.mark.parametrize(
    "energy, arguments, message",
    [
        (TwoPhase(jnp.full(42, 0.5), line_tension=2.0, interface_width=0.6), {}, "number or a"),
        (energy(), {"mean": 0.5, "amount": 3.0}, "not both"),
        (energy(), {"mean": 1.2}, r"\(0, 1\)"),
        (energy() + jw.energies.Willmore(), {}, "one bending energy"),
        (jw.energies.CanhamHelfrich(Mixture(0.5, 1.0)), {}, "energy of mixing"),
    ],
)
def test_what_means_nothing_is_refused(halves, energy, arguments, message):
    mesh, x, c = halves.mesh, halves.x, halves.c
    with pytest.raises(ValueError, match=message):
        equilibria.equilibrium(mesh, x, energy, c=c, reduced_volume=0.85, **arguments)


@pytest.mark.slow
def test_phases_of_unequal_moduli_have_their_axisymmetric_energy():
    """b_b = ½ and 1, b_k = 0 and −1, κ = 1, λ = 4, ℓ = 0.15 on 642 nodes; ℓ is 1.1 h there."""
    mesh, x = equilibria.spheroid(0.85, level=2)
    moduli = Mixture(1.0, 0.5), 0.0, Mixture(-1.0, 0.0)
    two = TwoPhase(*moduli, line_tension=4.0, interface_width=0.15)
    c = jw.phases.stripe(mesh, x, 0.15)
    shape = equilibria.equilibrium(mesh, x, two, c=c, mean=0.5, reduced_volume=0.85)
    assert shape.negative_directions == 0
    np.testing.assert_allclose(shape.total_energy, 58.27815076, rtol=4e-3)
    np.testing.assert_allclose(shape.gaussian_energy, -6.907465, rtol=1e-2)

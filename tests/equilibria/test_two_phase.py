"""Equilibria of two phases: the axisymmetric energies, the envelope theorem, what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.energies import Mixture, TwoPhase


def start(level, width):
    """A spheroid of area 4π and reduced volume 0.85 with a stripe."""
    mesh, x = jw.mesh.ellipsoid((0.7119562, 0.7119562, 1.6769200), level, degree=2)
    x = x * jnp.sqrt(4 * jnp.pi / jw.surface.area(mesh, x))
    return mesh, x, jw.phases.stripe(mesh, x, width, 0.5)


def energy_of(line_tension=2.0, width=0.6, soft=0.5, stiff=0.6):
    moduli = Mixture(soft, stiff), Mixture(0.0, 0.4)
    return TwoPhase(*moduli, line_tension=line_tension, interface_width=width)


@pytest.fixture(scope="module")
def coarse():
    mesh, x, c = start(0, 0.6)
    return jw.equilibria.equilibrium(mesh, x, energy_of(), c=c, reduced_volume=0.85)


def test_area_volume_and_amount_are_held(coarse):
    mesh, x = coarse.mesh, coarse.x
    _, first, c = start(0, 0.6)
    A = float(jw.surface.area(mesh, first))
    assert coarse.succeeded and coarse.negative_directions == 0
    np.testing.assert_allclose(coarse.parameters.area, A, rtol=1e-5)
    amount = jw.phases.amount(mesh, first, c)
    # The functional has a quadrature of its own.
    np.testing.assert_allclose(jw.phases.amount(mesh, x, coarse.c), amount, rtol=1e-3)


def line(p):
    return p.two_phase.mixing.well.line_tension


@pytest.fixture(scope="module")
def compiled(coarse):
    """Energy and a number that sees all of the shape, with reverse and forward derivatives."""

    def outputs(p):
        shape = jw.equilibria.resolve(coarse, p)
        assert shape.c is not None
        seen = jnp.sum(shape.x**2 * jnp.array([[1.0, 2.0, 3.0]])) + jnp.sum(shape.c**3)
        return jnp.stack([shape.total_energy, seen])

    arrays, rest = eqx.partition(coarse.parameters, eqx.is_array)
    of = lambda arrays: outputs(eqx.combine(arrays, rest))
    with_slopes = jax.jit(lambda arrays: (of(arrays), jax.jacrev(of)(arrays)))
    along = jax.jit(lambda arrays, direction: jax.jvp(of, (arrays,), (direction,))[1])
    return arrays, with_slopes, along


def test_derivatives_of_the_energy_are_those_of_the_envelope_theorem(coarse, compiled):
    """∂E*/∂∫c = μ, ∂E*/∂V = P, and ∂E*/∂λ = E_GL/λ, which is linear in the line tension."""
    arrays, with_slopes, _ = compiled
    slopes = jax.tree.map(lambda rows: rows[0], with_slopes(arrays)[1])
    # What the soft rigid constraints store is not in the energy; seen: 8e-6.
    np.testing.assert_allclose(slopes.amount, coarse.chemical_potential, rtol=2e-5)
    np.testing.assert_allclose(slopes.volume, coarse.pressure, rtol=1e-6)
    expected = coarse.mixing_energy / line(coarse.parameters)
    np.testing.assert_allclose(line(slopes), expected, rtol=1e-6)


def test_derivatives_of_the_shape_by_the_line_tension_agree_with_differences(compiled):
    """Forward as reverse, and Taylor's remainder of second order."""
    arrays, with_slopes, along = compiled
    value, slopes = with_slopes(arrays)
    still = jax.tree.map(jnp.zeros_like, arrays)
    forward = along(arrays, eqx.tree_at(line, still, jnp.ones(())))
    np.testing.assert_allclose(line(slopes), forward, rtol=1e-9)
    hs = np.array([4e-2, 2e-2, 1e-2])
    ends = [with_slopes(eqx.tree_at(line, arrays, line(arrays) + h))[0][1] for h in hs]
    remainders = [
        abs(float(end - value[1] - h * forward[1])) for end, h in zip(ends, hs, strict=True)
    ]
    assert abs(np.polyfit(np.log(hs), np.log(remainders), 1)[0] - 2) < 0.1, remainders


def test_what_has_no_equilibrium_of_two_phases_is_refused(coarse):
    mesh, x, c = coarse.mesh, coarse.x, coarse.c
    with pytest.raises(ValueError, match="`c`"):
        jw.equilibria.equilibrium(mesh, x, energy_of(), reduced_volume=0.85)
    with pytest.raises(ValueError, match="`c`"):
        jw.equilibria.equilibrium(mesh, x, energy_of(), c=c[:5], reduced_volume=0.85)
    with pytest.raises(ValueError, match="c"):
        jw.equilibria.equilibrium(mesh, x, c=c, reduced_volume=0.85)


@pytest.mark.slow
@pytest.mark.parametrize(
    "curvature, bending, tension, pressure",
    [(0.0, 32.383853, -1.9630, -3.0959), (Mixture(0.0, 1.5), 17.926475, -1.1864, -0.4220)],
    ids=["equal phases", "one curved phase"],
)
def test_vesicles_have_their_axisymmetric_energies(curvature, bending, tension, pressure):
    """κ = 1, λ = 4, ℓ = 0.3, v = 0.85 on 642 nodes; the flow to rest is as far away."""
    mesh, x, c = start(2, 0.3)
    energy = TwoPhase(0.5, curvature, line_tension=4.0, interface_width=0.3)
    shape = jw.equilibria.equilibrium(mesh, x, energy, c=c, reduced_volume=0.85)
    assert shape.negative_directions == 0
    np.testing.assert_allclose(shape.energy, bending, rtol=7e-4)
    np.testing.assert_allclose(shape.tension, tension, atol=0.02)
    np.testing.assert_allclose(shape.pressure, pressure, atol=0.05)

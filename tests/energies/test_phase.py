"""Energies of a concentration: interfaces on a sphere, closed forms, what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import FloryHuggins, FreeEnergy, GinzburgLandau, QuarticWell
from jaxwillmore.fem import Jet, inner, load
from jaxwillmore.mesh import icosphere
from jaxwillmore.phases import resolution


@eqx.filter_jit
def value(energy, mesh, x, c):
    return energy(mesh, x, {"c": c})


def cap(x, theta, width):
    """The profile in equilibrium of a cap of opening θ on the unit sphere."""
    angle = jnp.arccos(jnp.clip(x[:, 2], -1.0, 1.0))
    return jax.nn.sigmoid((theta - angle) / width)


@pytest.mark.parametrize("theta", [np.pi / 2, np.pi / 3])
def test_a_cap_costs_its_line_tension_times_the_length_of_its_edge(theta):
    """2πλ sin θ up to O((ℓ/R)²) (π²/6 − 1 of it at the equator) and the error of the mesh."""
    mesh, x = icosphere(2, 2)
    width = 0.15
    found = value(GinzburgLandau(2.0, width), mesh, x, cap(x, theta, width))
    assert abs(found / (4 * np.pi * np.sin(theta)) - 1) < width**2


def test_the_profile_has_hardly_more_than_the_least_energy():
    """E/λ of the equilibrium at x = ½: 6.2422775511 at ℓ = 0.1, 6.1142370441 at ℓ = 0.2.

    The profile on a plane is off by O((ℓ/R)²) in c and by the square of that in the energy; the
    mesh adds 6e-4 (ℓ/h)⁻⁴.
    """
    mesh, x = icosphere(2, 2)
    for width, least in ((0.1, 6.2422775511), (0.2, 6.1142370441)):
        excess = value(GinzburgLandau(1.0, width), mesh, x, cap(x, np.pi / 2, width)) / least - 1
        allowed = width**4 + 8e-4 * float(resolution(mesh, x, width)) ** -4
        assert 0 < excess < allowed, (excess, allowed)


def test_a_pure_mixture_has_the_energy_of_its_area():
    """4πR² Ψ(c) in every well; 162 nodes know the area to 1e-3."""
    mesh, x = icosphere(1, 2, radius=2.0)
    for well in (QuarticWell(1.0, 0.5), FloryHuggins(1.0, 3.0, 0.2)):
        found = value(GinzburgLandau(well=well), mesh, x, jnp.full(mesh.n_nodes, 0.3))
        exact = 16 * np.pi * well.potential(jnp.asarray(0.3))
        np.testing.assert_allclose(found, exact, rtol=2e-3)


def test_the_gradient_term_has_a_closed_form():
    """½γ∫|∇z|² = ½γ·8π/3 on the unit sphere, for a well so shallow that Ψ is not seen."""
    mesh, x = icosphere(1, 2)
    energy = GinzburgLandau(1e-9, 1e9)  # γ = 6, ζ = 1.2e-17
    np.testing.assert_allclose(value(energy, mesh, x, x[:, 2]), 8 * np.pi, rtol=3e-3)


def test_the_slope_by_line_tension_is_the_energy_over_it():
    """E is linear in λ at fixed ℓ, and λ and ℓ are leaves."""
    mesh, x = icosphere(1, 2)
    c = cap(x, 1.2, 0.3)
    energy = GinzburgLandau(2.0, 0.3)
    slope = eqx.filter_grad(lambda energy: value(energy, mesh, x, c))(energy)
    expected = value(energy, mesh, x, c) / 2
    np.testing.assert_allclose(slope.well.line_tension, expected, rtol=1e-12)
    twice = value(energy.scaled(2.0), mesh, x, c)
    np.testing.assert_allclose(twice, 4 * expected, rtol=1e-13)


def test_the_slope_by_the_concentration_is_that_of_the_weak_form():
    r"""$(\Psi', \delta c) + \gamma(\nabla c, \nabla\delta c)$ by the rule of flows, to rounding.

    Only then does a flow of c lower exactly this number.
    """
    mesh, x = icosphere(0, 2)
    energy, c = GinzburgLandau(1.0, 0.5), jnp.sin(2 * x[:, 2]) + x[:, 0]
    slope = jax.grad(lambda c: energy(mesh, x, {"c": c}))(c)

    def tested(_, f, phi, grad):
        by = jax.grad(energy.density)(f.c)
        return by.value * phi + inner(by.grad, grad)

    np.testing.assert_allclose(slope, load(mesh, x, tested, {"c": c}), atol=1e-12)


def test_the_density_at_a_point_is_what_is_integrated():
    c = Jet(jnp.asarray(0.25), jnp.array([1.0, 2.0, 2.0]))
    expected = 0.25 * 24.0 * (0.25 * 0.75) ** 2 + 0.5 * 1.5 * 9.0  # λ = 1, ℓ = ½: ζ = 24, γ = 3
    found = GinzburgLandau(1.0, 0.5).density(c)
    np.testing.assert_allclose(found, expected + 0.5 * 1.5 * 9.0, rtol=1e-14)


def test_a_free_energy_is_the_integral_of_a_function():
    """∫z² = 4π/3 and ∫(1 + z) ln(1 + z) = 2π∫₀² s ln s ds = 2π(2 ln 2 − 1)."""
    mesh, x = icosphere(2, 2)
    u = 1.0001 + x[:, 2]
    square = FreeEnergy(lambda u: (u - 1.0001) ** 2)(mesh, x, {"u": u})
    np.testing.assert_allclose(square, 4 * np.pi / 3, rtol=3e-4)
    entropy = FreeEnergy(lambda u: u * jnp.log(u))(mesh, x, {"u": u})
    np.testing.assert_allclose(entropy, 2 * np.pi * (2 * np.log(2) - 1), rtol=1e-2)


def test_an_energy_of_a_concentration_needs_one():
    mesh, x = icosphere(0, 2)
    energy = GinzburgLandau(1.0, 0.5)
    for fields in (None, {}, {"H": x[:, 0]}):
        with pytest.raises(ValueError, match="GinzburgLandau needs a concentration `c`"):
            energy(mesh, x, fields)
    with pytest.raises(ValueError, match=r"one number for each of the 42 nodes; got shape \(7,\)"):
        energy(mesh, x, {"c": np.ones(7)})
    with pytest.raises(ValueError, match="`c` must hold 64-bit floats; got float32"):
        energy(mesh, x, {"c": jnp.ones(42, jnp.float32)})
    with pytest.raises(ValueError, match="FreeEnergy needs a concentration `u`"):
        FreeEnergy(jnp.sin)(mesh, x, {"c": x[:, 0]})


@pytest.mark.parametrize(
    "arguments",
    [{}, {"line_tension": 1.0}, {"line_tension": 1.0, "well": QuarticWell(1.0, 1.0)}],
    ids=["none", "half", "both"],
)
def test_a_well_is_given_once(arguments):
    with pytest.raises(ValueError, match="Give `line_tension` and `interface_width`, or a `well`"):
        GinzburgLandau(**arguments)

"""The energy of a membrane of two phases: closed forms, Gauss–Bonnet, where moduli are taken."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import CanhamHelfrich, GinzburgLandau, Mixture, TwoPhase
from jaxwillmore.fem import Jet, integrate
from jaxwillmore.mesh import icosphere, torus
from jaxwillmore.surface import mean_curvature_vector

B_B, H0, B_K = Mixture(0.5, 1.2), Mixture(0.3, 1.5), Mixture(0.2, -1.0)
ENERGY = TwoPhase(B_B, H0, B_K, line_tension=1.0, interface_width=0.5)


@pytest.fixture(scope="module")
def shape():
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]])
    return mesh, x, 0.5 + 0.4 * jnp.sin(2 * x[:, 2] + x[:, 0])


@eqx.filter_jit
def value(energy, mesh, x, fields):
    return energy(mesh, x, fields)


@eqx.filter_jit
def parts(energy, mesh, x, fields):
    return energy.parts(mesh, x, fields)


@pytest.mark.parametrize("c", [0.0, 0.3, 1.0])
def test_a_mixed_sphere_has_a_closed_form(c):
    """4πR² (b_b(c)(2/R − H₀(c))² + Ψ(c)) + 4π b_k(c); 162 nodes err by 3e-3 of ∫b_b H²."""
    R, c = 2.0, jnp.asarray(c)
    mesh, x = icosphere(1, 2, R)
    found = parts(ENERGY, mesh, x, {"c": jnp.full(mesh.n_nodes, c)})
    area = 4 * np.pi * R**2
    error = 3e-3 * 16 * np.pi * float(B_B(c))
    np.testing.assert_allclose(found["bending"], area * B_B(c) * (2 / R - H0(c)) ** 2, atol=error)
    np.testing.assert_allclose(found["gaussian"], 4 * np.pi * B_K(c), rtol=1e-12, atol=1e-13)
    potential = ENERGY.well.potential(c)
    np.testing.assert_allclose(found["phase"], area * potential, rtol=1e-2, atol=1e-14)


def test_it_is_the_sum_of_bending_and_mixing(shape):
    mesh, x, c = shape
    fields = {"c": c}
    sum_ = CanhamHelfrich(B_B, B_K, H0) + GinzburgLandau(1.0, 0.5)
    expected = value(sum_, mesh, x, fields)
    np.testing.assert_allclose(value(ENERGY, mesh, x, fields), expected, rtol=1e-14)
    total = sum(parts(ENERGY, mesh, x, fields).values())
    np.testing.assert_allclose(total, expected, rtol=1e-14)
    scales = [eqx.filter_jit(e.scale)(mesh, x, fields) for e in (ENERGY, sum_)]
    np.testing.assert_allclose(*scales, rtol=1e-14)


def test_two_equal_phases_are_one(shape):
    mesh, x, c = shape
    two = CanhamHelfrich(Mixture(0.7, 0.7), Mixture(0.2, 0.2), Mixture(0.9, 0.9))
    one = CanhamHelfrich(0.7, 0.2, 0.9)
    np.testing.assert_allclose(value(two, mesh, x, {"c": c}), value(one, mesh, x, {}), rtol=1e-13)


def test_gauss_bonnet_holds_for_every_constant_modulus(shape):
    """2πχ b_k for a number, equal phases, and a field of equal numbers; nothing on a torus."""
    mesh, x, c = shape
    for b_k in (0.3, Mixture(0.3, 0.3), np.full(mesh.n_nodes, 0.3), lambda c: 0.3 + 0 * c):
        energy = TwoPhase(gaussian_modulus=b_k, line_tension=1.0, interface_width=0.5)
        found = parts(energy, mesh, x, {"c": c})["gaussian"]
        np.testing.assert_allclose(found, 4 * np.pi * 0.3, rtol=1e-12)
    mesh, x = torus(1.0, 0.5, level=0, degree=2)
    energy = CanhamHelfrich(0.5, Mixture(2.0, 2.0))
    found = parts(energy, mesh, x, {"c": x[:, 2]})["gaussian"]
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_moduli_are_evaluated_at_the_quadrature_points(shape):
    """b_b(c_h) at a point, not the interpolation of b_b(c_j)."""
    mesh, x, c = shape
    c = jnp.round(c)  # jumps from node to node, where the two differ
    fields = {"c": c, "Y": mean_curvature_vector(mesh, x)}
    square = integrate(mesh, x, lambda _, f: B_B(f.c.value) * jnp.sum(f.Y.value**2), fields)
    found = value(CanhamHelfrich(B_B), mesh, x, {"c": c})
    np.testing.assert_allclose(found, square, rtol=1e-13)
    nodal = value(CanhamHelfrich(B_B(c)), mesh, x, {})
    assert abs(nodal / square - 1) > 1e-3


def test_fields_of_the_moment_replace_parameters(shape):
    """As a flow that carries them along passes them; others are ignored."""
    mesh, x, c = shape
    own = {
        "bending_modulus": 0.5 + 0.1 * x[:, 0],
        "spontaneous_curvature": x[:, 1],
        "gaussian_modulus": x[:, 2] ** 2,
    }
    expected = value(CanhamHelfrich(**own), mesh, x, {})
    carried = value(CanhamHelfrich(), mesh, x, own | {"H": c, "nu": x})
    np.testing.assert_allclose(carried, expected, rtol=1e-14)
    with pytest.raises(ValueError, match="`gaussian_modulus` must be one number, or one for each"):
        CanhamHelfrich()(mesh, x, {"gaussian_modulus": jnp.ones(3)})


def test_the_density_is_the_energy_at_one_point():
    r"""$b_b e^2 + b_k K + \Psi + \tfrac\gamma2|\nabla c|^2$, and its slopes make $\mu$."""
    c = Jet(jnp.asarray(0.3), jnp.array([0.2, -0.5, 1.0]))
    H, K = jnp.asarray(1.7), jnp.asarray(0.4)
    u, gamma, e = c.value, 3.0, H - H0(c.value)
    exact = B_B(u) * e**2 + B_K(u) * K + ENERGY.well.potential(u) + 0.5 * gamma * 1.29
    np.testing.assert_allclose(ENERGY.density(c, H, K), exact, rtol=1e-14)
    slope = jax.grad(ENERGY.density)(c, H, K)
    db_b, dH0, db_k, dPsi = (jax.grad(f)(u) for f in (B_B, H0, B_K, ENERGY.well.potential))
    mu = dPsi + db_b * e**2 - 2 * B_B(u) * e * dH0 + db_k * K
    np.testing.assert_allclose(slope.value, mu, rtol=1e-13)
    np.testing.assert_allclose(slope.grad, gamma * c.grad, rtol=1e-14)


def test_a_nodal_modulus_enters_the_density_by_its_jet():
    energy = TwoPhase(np.ones(42), line_tension=1.0, interface_width=0.5)
    c, one = Jet(jnp.asarray(0.0), jnp.zeros(3)), jnp.ones(())
    jet = Jet(jnp.asarray(0.7), jnp.ones(3))
    found = energy.density(c, 2 * one, one, {"bending_modulus": jet})
    np.testing.assert_allclose(found, 0.7 * 4, rtol=1e-14)
    with pytest.raises(ValueError, match="one number for every node"):
        energy.density(c, 2 * one, one)


def test_its_parameters_have_names():
    assert list(ENERGY.bending_parameters) == [
        "bending_modulus",
        "spontaneous_curvature",
        "gaussian_modulus",
    ]
    assert ENERGY.bending_parameters["gaussian_modulus"] is B_K
    assert ENERGY.well is ENERGY.mixing.well


def test_moduli_that_depend_on_c_need_one(shape):
    mesh, x, _ = shape
    with pytest.raises(ValueError, match="moduli that depend on c needs a concentration `c`"):
        CanhamHelfrich(B_B)(mesh, x)
    with pytest.raises(ValueError, match="GinzburgLandau needs a concentration"):
        TwoPhase(line_tension=1.0, interface_width=0.5)(mesh, x)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (
            {"bending_modulus": Mixture(1.0, -0.5)},
            "`bending_modulus` must be positive.*-0.5 at c = 1",
        ),
        ({"bending_modulus": 0.0}, "`bending_modulus` must be positive"),
        ({"line_tension": -1.0}, "`line_tension` must be positive; got -1"),
        ({"interface_width": None}, "Give `line_tension` and `interface_width`"),
    ],
)
def test_parameters_without_meaning_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        TwoPhase(**({"line_tension": 1.0, "interface_width": 0.5} | arguments))

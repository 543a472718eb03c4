"""Canham–Helfrich energy: closed form on spheres and tori, scaling, derivatives, bad parameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import CanhamHelfrich, Willmore
from jaxwillmore.mesh import icosphere, torus

from ..helpers import observed_order, taylor_remainders


@eqx.filter_jit
def value(energy, mesh, x):
    return energy(mesh, x)


@pytest.mark.parametrize("R, H0", [(1.0, 0.0), (1.0, 0.7), (2.5, -0.4), (2.0, 1.0)])
def test_spheres_have_a_closed_form(R, H0):
    """b_b (2/R − H₀)² 4πR² + 4π b_k, up to 1.7e-4 of the term b_b ∫H² = 16π b_b at this level."""
    mesh, x = icosphere(2, 2, R)
    found = value(CanhamHelfrich(0.8, 0.3, H0), mesh, x)
    expected = 0.8 * (2 / R - H0) ** 2 * 4 * np.pi * R**2 + 0.3 * 4 * np.pi
    np.testing.assert_allclose(found, expected, atol=3e-4 * 16 * np.pi * 0.8)


def test_the_scale_is_what_remains_where_the_energy_cancels():
    """b_b (4/R² + H₀²) 4πR² on a sphere, also at H₀ = 2/R; a constant b_k is no part of it."""
    R, H0, b = 2.0, 1.0, 0.8
    mesh, x = icosphere(1, 2, R)
    energy = CanhamHelfrich(b, 0.3, H0)
    expected = b * (4 / R**2 + H0**2) * 4 * np.pi * R**2
    np.testing.assert_allclose(energy.scale(mesh, x), expected, rtol=2e-3)
    assert abs(value(energy, mesh, x) - 0.3 * 4 * np.pi) < 3e-3 * expected
    field = CanhamHelfrich(b, jnp.full(mesh.n_nodes, 5.0), H0)
    np.testing.assert_allclose(field.scale(mesh, x), energy.scale(mesh, x), rtol=1e-12)


def test_gauss_bonnet_on_a_torus():
    """χ = 0: the Gaussian modulus does not enter."""
    mesh, x = torus(1.0, 0.5, level=0, degree=2)
    a, b = (value(CanhamHelfrich(0.5, k, 0.2), mesh, x) for k in (0.0, 100.0))
    np.testing.assert_array_equal(a, b)


def test_half_and_no_spontaneous_curvature_is_willmore():
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]])
    expected = value(Willmore(), mesh, x)
    np.testing.assert_allclose(value(CanhamHelfrich(), mesh, x), expected, rtol=1e-13)


def test_scaling_of_every_parameter():
    """E(b, H₀/λ) on λΓ equals E(b, H₀) on Γ; E is linear in b_b."""
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]])
    here = value(CanhamHelfrich(0.5, 0.0, 0.9), mesh, x)
    scaled = value(CanhamHelfrich(0.5, 0.0, 0.3), mesh, 3 * x)
    np.testing.assert_allclose(scaled, here, rtol=1e-11)
    twice = value(CanhamHelfrich(1.0, 0.0, 0.9), mesh, x)
    np.testing.assert_allclose(twice, 2 * here, rtol=1e-14)


def test_derivatives_by_parameters():
    """Closed forms: linear in the moduli, and dE/dH₀ = 2b_b(H₀|Γ| − ∫H)."""
    mesh, x = icosphere(1, 2)
    slopes = eqx.filter_jit(eqx.filter_grad(lambda energy: energy(mesh, x)))
    found = slopes(CanhamHelfrich(0.6, 0.2, 0.9))
    energy = value(CanhamHelfrich(0.6, 0.0, 0.9), mesh, x)
    np.testing.assert_allclose(found.bending_modulus, energy / 0.6, rtol=1e-12)
    np.testing.assert_allclose(found.gaussian_modulus, 4 * np.pi, rtol=1e-13)  # 2πχ
    expected = 2 * 0.6 * 4 * np.pi * (0.9 - 2.0)
    np.testing.assert_allclose(found.spontaneous_curvature, expected, rtol=3e-3)  # 162 nodes


# Parameters on the nodes.


def test_equal_numbers_on_all_nodes_are_that_number():
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]])
    one = jnp.ones(mesh.n_nodes)
    numbers = value(CanhamHelfrich(0.8, 0.3, 0.9), mesh, x)
    np.testing.assert_allclose(
        value(CanhamHelfrich(0.8 * one, 0.3 * one, 0.9 * one), mesh, x), numbers, rtol=1e-13
    )
    np.testing.assert_allclose(
        value(CanhamHelfrich(0.8, 0.3 * one, 0.9), mesh, x), numbers, rtol=1e-13
    )


def test_fields_on_a_sphere_have_a_closed_form():
    """b_b = 1 + z/2, H₀ = 1 + z, b_k = z²: ∫(1 + z/2)(1 − z)² = 4π(1 + ⅓ − ⅓) and ∫z² = 4π/3."""
    mesh, x = icosphere(1, 2)
    z = x[:, 2]
    found = value(CanhamHelfrich(1 + z / 2, z**2, 1 + z), mesh, x)
    # 162 nodes; the error is relative to ∫b_b H² = 16π, of which most cancels.
    np.testing.assert_allclose(found, 4 * np.pi * (1 + 1 / 3), atol=4e-3 * 16 * np.pi)


def test_the_slope_by_a_nodal_field_is_the_density_tested_with_the_basis():
    """dE/db_b(δ) = ∫δ(H − H₀)² and dE/db_k(δ) = ∫δK; E is linear in both."""
    mesh, x = icosphere(1, 2)
    one, delta = jnp.ones(mesh.n_nodes), 1 + x[:, 0] * x[:, 1]
    energy = CanhamHelfrich(0.6 * one, 0.2 * one, 0.9 * one)
    slope = eqx.filter_jit(eqx.filter_grad(lambda energy: energy(mesh, x)))(energy)
    for change, name in (
        (CanhamHelfrich(delta, 0.0, 0.9), "bending_modulus"),
        (CanhamHelfrich(0.6, delta, 0.9), "gaussian_modulus"),
    ):
        rest = value(CanhamHelfrich(0.6, 0.0, 0.9), mesh, x) if name[0] == "g" else 0.0
        found = jnp.vdot(getattr(slope, name), delta)
        np.testing.assert_allclose(found, value(change, mesh, x) - rest, rtol=1e-11)


def test_physicists_write_half_of_kappa():
    mesh, x = icosphere(1, 2)
    kappa = 2.0 + x[:, 0]
    same = CanhamHelfrich(kappa / 2, 0.1, 0.7), CanhamHelfrich.from_kappa(kappa, 0.1, 0.7)
    np.testing.assert_array_equal(*(value(energy, mesh, x) for energy in same))
    with pytest.raises(ValueError, match="`kappa` must be positive; got -1"):
        CanhamHelfrich.from_kappa(-1.0)


@pytest.mark.parametrize("name", ["bending_modulus", "gaussian_modulus", "spontaneous_curvature"])
def test_a_field_of_another_length_is_named(name):
    mesh, x = icosphere(0, 2)
    energy = CanhamHelfrich(**{name: np.ones(7)})
    with pytest.raises(ValueError, match=f"`{name}` must be one number, or one for each of the 42"):
        value(energy, mesh, x)


def test_the_node_of_a_bad_number_is_named():
    with pytest.raises(ValueError, match="`bending_modulus` must be positive; got -2.0 at node 1"):
        CanhamHelfrich([1.0, -2.0])
    with pytest.raises(ValueError, match="`gaussian_modulus` must be finite; got inf at node 0"):
        CanhamHelfrich(1.0, [np.inf, 1.0])


@pytest.mark.slow
def test_derivatives_by_parameters_and_nodes():
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]])

    @jax.jit
    def f(v):
        parameters, nodes = v[:3], v[3:].reshape(x.shape)
        return CanhamHelfrich(*parameters)(mesh, nodes)

    v = jnp.concatenate([jnp.array([0.6, 0.2, 0.9]), x.reshape(-1)])
    direction, steps = jr.normal(jr.key(0), v.shape), (1e-3, 5e-4, 2.5e-4)
    order = observed_order(steps, taylor_remainders(f, v, direction, steps))
    assert abs(order - 2.0) < 0.1, order
    gradient = jax.grad(f)(v)
    _, forward = jax.jvp(f, (v,), (direction,))
    np.testing.assert_allclose(forward, jnp.vdot(gradient, direction), rtol=1e-10)


@pytest.mark.parametrize(
    "arguments, name",
    [
        ({"bending_modulus": 0.0}, "bending_modulus"),
        ({"bending_modulus": -1.0}, "bending_modulus"),
        ({"bending_modulus": float("nan")}, "bending_modulus"),
        ({"bending_modulus": "stiff"}, "bending_modulus"),
        ({"bending_modulus": [0.5, -1.0]}, "bending_modulus"),
        ({"bending_modulus": np.array([0.5, np.nan])}, "bending_modulus"),
        ({"gaussian_modulus": np.ones((3, 1))}, "gaussian_modulus"),
        ({"gaussian_modulus": float("inf")}, "gaussian_modulus"),
        ({"spontaneous_curvature": None}, "spontaneous_curvature"),
        ({"spontaneous_curvature": 1j}, "spontaneous_curvature"),
    ],
)
def test_bad_parameters_are_named(arguments, name):
    with pytest.raises(ValueError, match=f"`{name}` must be"):
        CanhamHelfrich(**arguments)

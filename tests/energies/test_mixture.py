"""Parameters that depend on the concentration: ends, slopes, jets, what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import CanhamHelfrich, Mixture, modulus_at, modulus_jet
from jaxwillmore.fem import Jet

C = Jet(jnp.asarray(0.3), jnp.array([1.0, -2.0, 0.5]))


def test_a_mixture_has_the_values_of_both_phases_and_no_slope_there():
    mixture = Mixture(0.5, 2.0)
    ends = jnp.array([0.0, 1.0])
    np.testing.assert_array_equal(mixture(ends), [0.5, 2.0])
    np.testing.assert_array_equal(jax.vmap(jax.grad(mixture))(ends), [0.0, 0.0])
    np.testing.assert_allclose(mixture(jnp.asarray(0.5)), 1.25, rtol=1e-15)


def test_a_mixture_stays_between_its_phases_where_c_overshoots():
    values = Mixture(0.1, 5.0)(jnp.linspace(-0.5, 1.5, 101))
    assert values.min() >= 0.1 and values.max() <= 5.0


def test_both_phases_are_parameters_to_fit():
    """dm/dm₀ = 1 − S and dm/dm₁ = S, S(¼) = 5/32."""
    slope = jax.grad(lambda m: m(jnp.asarray(0.25)))(Mixture(0.5, 2.0))
    np.testing.assert_allclose([slope.at_zero, slope.at_one], [27 / 32, 5 / 32], rtol=1e-15)


def test_a_multiple_of_a_modulus_is_a_modulus():
    c = jnp.array([0.1, 0.6])
    np.testing.assert_allclose((2.0 * Mixture(0.5, 2.0))(c), 2 * Mixture(0.5, 2.0)(c), rtol=1e-15)
    exponential = CanhamHelfrich(jnp.exp).bending_modulus
    np.testing.assert_allclose((3.0 * exponential)(c), 3 * jnp.exp(c), rtol=1e-15)
    np.testing.assert_allclose((exponential * 3.0)(c), 3 * jnp.exp(c), rtol=1e-15)


@pytest.mark.parametrize(
    "modulus, value, slope",
    [
        (2.5, 2.5, 0.0),
        (jnp.asarray(2.5), 2.5, 0.0),
        (Mixture(1.0, 3.0), 1 + 2 * 0.09 * 2.4, 2 * 6 * 0.3 * 0.7),
        (lambda c: c**3, 0.027, 0.27),
    ],
    ids=["number", "array", "mixture", "function"],
)
def test_a_jet_is_the_value_and_the_chain_rule(modulus, value, slope):
    jet = modulus_jet(modulus, C)
    np.testing.assert_allclose(jet.value, value, rtol=1e-14)
    np.testing.assert_allclose(jet.grad, slope * C.grad, rtol=1e-14)
    np.testing.assert_allclose(modulus_at(modulus, C.value), value, rtol=1e-14)


def test_a_nodal_field_enters_a_point_by_its_jet():
    own = Jet(jnp.asarray(7.0), jnp.ones(3))
    assert modulus_jet(own, C) is own and modulus_at(own, C.value) is own.value
    for function, at in ((modulus_jet, C), (modulus_at, C.value)):
        with pytest.raises(ValueError, match=r"one number for every node, shape \(5,\)"):
            function(jnp.ones(5), at)


def test_a_function_of_one_concentration_takes_many():
    """Also one that cannot take an array by itself."""
    modulus = CanhamHelfrich(lambda c: jax.lax.cond(c > 0.5, lambda: 1.0, lambda: 2.0))
    found = modulus.bending_modulus(jnp.array([0.2, 0.8]))
    np.testing.assert_array_equal(found, [2.0, 1.0])


@pytest.mark.parametrize(
    "arguments, message",
    [
        (
            {"bending_modulus": Mixture(0.5, -1.0)},
            "`bending_modulus` must be positive.*-1 at c = 1",
        ),
        ({"bending_modulus": Mixture(0.0, 1.0)}, "`bending_modulus` must be positive.*0 at c = 0"),
        ({"bending_modulus": lambda c: 0.5 - c}, "`bending_modulus` must be positive"),
        ({"spontaneous_curvature": lambda c: 1 / c}, "`spontaneous_curvature` must be finite"),
        ({"gaussian_modulus": lambda c: jnp.stack([c, c])}, r"return one number; got shape \(2,\)"),
    ],
)
def test_a_modulus_without_meaning_in_a_phase_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        CanhamHelfrich(**arguments)


def test_the_ends_of_a_mixture_are_numbers():
    with pytest.raises(ValueError, match="`at_one` must be one finite number; got nan"):
        Mixture(1.0, float("nan"))


def test_traced_phases_pass():
    f = eqx.filter_jit(lambda a, c: CanhamHelfrich(Mixture(a, 1.0)).bending_modulus(c))
    np.testing.assert_allclose(f(jnp.asarray(0.5), jnp.asarray(0.0)), 0.5)

"""Double wells: closed forms, tabulated wells and line tensions, derivatives, what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import FloryHuggins, QuarticWell
from jaxwillmore.fem import Jet


def test_a_quartic_well_is_made_of_its_line_tension_and_width():
    """γ = 6λℓ, ζ = 12λ/ℓ, so that λ = √(γζ/2)/6 and ℓ = √(2γ/ζ)."""
    well = QuarticWell(4.0, 0.15)
    gamma, zeta = well.gradient_coefficient, well.strength
    np.testing.assert_allclose(jnp.sqrt(gamma * zeta / 2) / 6, 4.0, rtol=1e-15)
    np.testing.assert_allclose(jnp.sqrt(2 * gamma / zeta), 0.15, rtol=1e-15)
    np.testing.assert_allclose(well.potential(jnp.asarray(0.5)), zeta / 64, rtol=1e-15)
    # The width is √(γ/Ψ'') at both wells.
    for c in well.wells:
        curvature = jax.grad(jax.grad(well.potential))(c)
        np.testing.assert_allclose(jnp.sqrt(gamma / curvature), 0.15, rtol=1e-14)


def test_the_line_tension_is_the_energy_of_the_profile_on_a_line():
    """∫ Ψ + ½γ c'² ds = λ for c = 1/(1 + e^{−s/ℓ}), summed over a line."""
    well = QuarticWell(0.7, 0.2)
    s = jnp.linspace(-8.0, 8.0, 2001)
    profile = lambda s: jax.nn.sigmoid(s / 0.2)
    slope = jax.vmap(jax.grad(profile))(s)
    grad = jnp.stack([slope, 0 * s, 0 * s], axis=1)
    density = jax.vmap(lambda c, g: well.density(Jet(c, g)))(profile(s), grad)
    np.testing.assert_allclose(jnp.sum(density) * (s[1] - s[0]), 0.7, rtol=1e-12)


@pytest.mark.parametrize(
    "ratio, low, tension", [(3.0, 0.0707201817, 0.288271868), (4.0, 0.0212479880, 0.558546948)]
)
def test_flory_huggins_has_the_wells_and_line_tension_of_the_table(ratio, low, tension):
    """λ/√(γθ) depends on ω/θ alone."""

    @jax.jit
    def numbers(well):
        return well.wells, well.line_tension, jax.grad(well.potential)(well.wells[0])

    for theta, gamma in ((1.0, 1.0), (0.3, 0.07)):
        wells, line_tension, slope = numbers(FloryHuggins(theta, ratio * theta, gamma))
        np.testing.assert_allclose(wells, [low, 1 - low], atol=1e-9)
        np.testing.assert_allclose(line_tension / np.sqrt(gamma * theta), tension, atol=1e-9)
        np.testing.assert_allclose(slope, 0.0, atol=1e-13)


def test_the_width_of_flory_huggins_is_that_of_its_wells():
    well = FloryHuggins(0.4, 1.3, 0.02)
    curvature = jax.grad(jax.grad(well.potential))(well.wells[1])
    np.testing.assert_allclose(well.interface_width, jnp.sqrt(0.02 / curvature), rtol=1e-11)


def test_wells_and_line_tension_have_derivatives_by_every_parameter():
    """Against central differences, whose error is of order 1e-9."""

    def numbers(v):
        well = FloryHuggins(v[0], v[1], v[2])
        return jnp.stack([well.wells[0], well.line_tension, well.interface_width])

    v, step = jnp.array([0.5, 1.4, 0.03]), 1e-5
    numbers = jax.jit(numbers)
    exact = jax.jit(jax.jacrev(numbers))(v)
    np.testing.assert_allclose(exact, jax.jit(jax.jacfwd(numbers))(v), rtol=1e-10, atol=1e-14)
    rows = step * jnp.eye(3)
    by_differences = [(numbers(v + d) - numbers(v - d)) / (2 * step) for d in rows]
    np.testing.assert_allclose(exact, np.stack(by_differences, axis=1), rtol=1e-7, atol=1e-9)


def test_the_implicit_derivative_of_the_well_is_exact_to_second_order():
    """With Ψ'(c, ω) = 0: dc/dω = −(1 − 2c)/Ψ'' and its derivative along the branch."""
    well = lambda omega: FloryHuggins(1.0, omega, 1.0).wells[0]
    omega = jnp.asarray(3.3)
    rate = lambda c, omega: -(1 - 2 * c) / (1 / (c * (1 - c)) - 2 * omega)
    c = well(omega)
    first = jax.jit(jax.grad(well))(omega)
    np.testing.assert_allclose(first, rate(c, omega), rtol=1e-11)
    _, second = jax.jvp(rate, (c, omega), (first, jnp.ones(())))
    np.testing.assert_allclose(jax.jit(jax.grad(jax.grad(well)))(omega), second, rtol=1e-9)


def test_the_continuation_of_the_logarithm_is_twice_continuously_differentiable():
    well = FloryHuggins(1.0, 3.0, 1.0, cutoff=0.01)
    derivatives = [well.potential]
    for _ in range(2):
        derivatives.append(jax.grad(derivatives[-1]))
    edges = jnp.array([0.01, 0.99])
    for f in derivatives:
        f = jax.jit(jax.vmap(f))
        np.testing.assert_allclose(f(edges - 1e-12), f(edges + 1e-12), atol=1e-6)
    # Beyond it the second derivative does not change.
    second = jax.jit(jax.vmap(derivatives[2]))(jnp.array([0.01, 0.0, -0.5]))
    np.testing.assert_allclose(second, second[0], rtol=1e-13)


def test_flory_huggins_is_finite_for_every_concentration():
    c = jnp.array([-1.0, 0.0, 1e-300, 0.5, 1.0, 1.0 + 1e-15, 2.0])
    well = FloryHuggins(0.5, 1.5, 0.1)
    f = well.potential
    for order in range(4):
        assert jnp.all(jnp.isfinite(jax.jit(jax.vmap(f))(c))), order
        f = jax.grad(f)
    by_parameters = jax.jit(jax.vmap(lambda c: jax.grad(lambda w: w.potential(c))(well)))(c)
    assert all(jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(by_parameters))


def test_a_multiple_of_a_well_has_a_multiple_of_the_line_tension_and_the_same_width():
    for well in (QuarticWell(0.7, 0.2), FloryHuggins(0.5, 1.5, 0.1)):
        twice = well.scaled(2.0)
        np.testing.assert_allclose(twice.line_tension, 2 * well.line_tension, rtol=1e-12)
        np.testing.assert_allclose(twice.interface_width, well.interface_width, rtol=1e-12)


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: QuarticWell(0.0, 0.1), "`line_tension` must be positive; got 0"),
        (lambda: QuarticWell(1.0, -0.1), "`interface_width` must be positive; got -0.1"),
        (lambda: FloryHuggins(0.0, 1.0, 1.0), "`entropy_coefficient` must be positive; got 0"),
        (lambda: FloryHuggins(1.0, 2.0, 1.0), "`interaction` > 2 `entropy_coefficient` = 2; got 2"),
        (lambda: FloryHuggins(1.0, 3.0, -1.0), "`gradient_coefficient` must be positive"),
        (lambda: FloryHuggins(1.0, 3.0, 1.0, 0.08), "`cutoff` must lie between 0 and .* 0.0707"),
        (lambda: FloryHuggins(1.0, 3.0, 1.0, 0.0), "`cutoff` must lie between 0"),
    ],
)
def test_parameters_without_two_phases_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()

"""The saddle-point system with a concentration: its derivatives, its energy, its gauge."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore import mesh as meshes, surface
from jaxwillmore.energies import AreaDifference, FloryHuggins, Mixture, TwoPhase
from jaxwillmore.equilibria._density import mixing
from jaxwillmore.equilibria._functional import N_GLOBALS, EquilibriumSystem
from jaxwillmore.equilibria._parameters import Parameters, Units, phases_of
from jaxwillmore.equilibria._reference import prepare, reference
from jaxwillmore.equilibria._shape import constant_path, no_direction

MODULI = Mixture(0.5, 0.8), Mixture(0.2, 1.1)


def parameters(energy, of_measures):
    numbers = (jnp.asarray(v) for v in (0.65, 0.65, 12.0, 4.0, 0.2, 0.1))
    amount = jnp.asarray(5.0)
    return Parameters(*numbers, global_energy=of_measures, two_phase=energy, amount=amount)


def system(energy, level=0, inverse_tau=3.0):
    """On an ellipsoid that has turned, with a stripe of which no axis is the normal."""
    mesh, x = meshes.ellipsoid((0.8, 1.0, 1.3), level=level, degree=2)
    units = Units(jnp.asarray(1.1), jnp.asarray(0.9), jnp.zeros(3))
    p = parameters(energy, AreaDifference(2.0, 0.7, 0.05))
    c = jax.nn.sigmoid((x[:, 2] + 0.3 * x[:, 0]) / 0.5)
    r, p = reference(mesh, *prepare(mesh), x, c), units.parameters(p)
    flags = jnp.asarray(True), jnp.asarray(False)
    return EquilibriumSystem(r, p, constant_path(r, p), *flags, jnp.asarray(inverse_tau))


def along_the_line_tension(problem):
    """The same with a path, whose parameter changes the energy of the line and the amount."""
    where = lambda p: (p.two_phase.energy.mixing.well.line_tension, p.amount)
    direction = eqx.tree_at(where, no_direction(problem.parameters), (jnp.ones(()), jnp.ones(())))
    return eqx.tree_at(lambda s: s.path.direction, problem, direction)


def somewhere(problem):
    n = problem.reference.n
    assert problem.has_phases
    keys = jr.split(jr.key(1), 4)
    c = problem.reference.c + 0.05 * jr.normal(keys[3], (len(n),))
    y = 2.0 * n + 0.1 * jr.normal(keys[1], n.shape)
    fields = jnp.concatenate([y, c[:, None]], axis=1)
    g = jr.normal(keys[2], (problem.n_globals,))
    return problem.pack(0.01 * jr.normal(keys[0], (len(n),)), fields, g)


@pytest.mark.parametrize("gaussian", [0.0, Mixture(-0.6, 0.4)], ids=["equal", "unequal"])
def test_jacobian_is_the_derivative_of_the_residual(gaussian):
    energy = TwoPhase(*MODULI, gaussian, line_tension=2.0, interface_width=0.5)
    problem = along_the_line_tension(system(energy))
    v = somewhere(problem)
    direction = jr.normal(jr.key(2), v.shape)
    _, exact = jax.jvp(eqx.filter_jit(problem.residual), (v,), (direction,))
    product = eqx.filter_jit(lambda p, v: p.jacobian(v).mv(direction))(problem, v)
    np.testing.assert_allclose(product, exact, atol=1e-10)


def test_maximising_over_y_gives_the_bending_energy_of_both_phases():
    """With y = κ(H − H0)ν and its neighbours: the largest is ∫ b_b(c)(H − H0(c))² on a sphere."""
    mesh, x = meshes.icosphere(2, degree=2)
    units = Units(jnp.ones(()), jnp.ones(()), jnp.zeros(3))
    energy = TwoPhase(*MODULI, line_tension=2.0, interface_width=0.5)
    c = jax.nn.sigmoid(x[:, 2] / 0.5)
    p = units.parameters(parameters(energy, None))
    r = reference(mesh, *prepare(mesh), x, c)
    flags = jnp.asarray(True), jnp.asarray(True)
    problem = EquilibriumSystem(r, p, constant_path(r, p), *flags, jnp.zeros(()))

    def value(stretch):
        y = stretch * (2 * MODULI[0](c) * (2 - MODULI[1](c)))[:, None] * x
        fields = jnp.concatenate([y, c[:, None]], axis=1)
        return problem.energies(problem.pack(jnp.zeros(len(x)), fields, jnp.zeros(N_GLOBALS + 1)))

    exact = energy.bending.parts(mesh, x, {"c": c})["bending"]
    # Both have errors of order 4 in h, of 2e-4 on 642 nodes.
    np.testing.assert_allclose(value(1.0).bending, exact, rtol=5e-4)
    assert value(1.0).bending > value(1.03).bending
    assert value(1.0).bending > value(0.97).bending
    np.testing.assert_allclose(value(1.0).mixing, energy.mixing(mesh, x, {"c": c}), rtol=1e-4)


def test_a_rigid_motion_is_seen_however_its_normal_part_and_the_concentration_share_it():
    """A rotation of a sphere moves no node along its normal, but the concentration."""
    mesh, x = meshes.icosphere(2, degree=2)
    c = 0.2 * x[:, 0] * x[:, 2] + 0.3 * x[:, 2]
    r = reference(mesh, *prepare(mesh), x, c)
    angle = 1e-4
    turned = x @ jnp.array([[1.0, 0, 0], [0, jnp.cos(angle), jnp.sin(angle)],
                            [0, -jnp.sin(angle), jnp.cos(angle)]])  # fmt: skip
    back = 2 * x - turned
    change = 0.2 * back[:, 0] * back[:, 2] + 0.3 * back[:, 2] - c
    assert float(jnp.max(jnp.abs(r.rigid[3:] @ jnp.ones(len(x))))) < 1e-12
    assert r.rigid_c is not None
    seen = r.rigid_c @ change / angle
    # ∫|(e₁ × x)·∇c|², the square of what the motion does to c, is the row's own answer.
    slope = tangential_gradient(x)
    expected = jnp.sum(jnp.cross(jnp.array([[1.0, 0, 0]]), x) * slope, axis=1)
    mass = r.times_mass(expected)
    np.testing.assert_allclose(seen[3], jnp.vdot(expected, mass), rtol=1e-2)


def tangential_gradient(x):
    """Of the polynomial c, on the sphere."""
    full = jnp.stack([0.2 * x[:, 2], jnp.zeros(len(x)), 0.2 * x[:, 0] + 0.3], axis=1)
    return full - jnp.sum(full * x, axis=1, keepdims=True) * x


def test_the_gaussian_part_is_that_of_the_energy():
    energy = TwoPhase(*MODULI, Mixture(-0.6, 0.4), line_tension=2.0, interface_width=0.5)
    problem = system(energy)
    r, kappa = problem.reference, phases_of(problem.parameters).kappa
    assert r.c is not None
    load = surface.gaussian_curvature_load(r.mesh, r.X)
    fields = jnp.concatenate([r.n, r.c[:, None]], axis=1)
    v = problem.pack(jnp.zeros(len(r.n)), fields, jnp.zeros(problem.n_globals))
    expected = jnp.vdot(energy.bending.gaussian_modulus(r.c), load) / kappa
    np.testing.assert_allclose(problem.energies(v).gaussian, expected, rtol=1e-12)


def test_a_step_is_as_long_as_its_displacement_or_a_quarter_of_the_change():
    problem = system(TwoPhase(*MODULI, line_tension=2.0, interface_width=0.5))
    r = problem.reference

    def step(s, change):
        fields = jnp.concatenate([2 * r.n, (r.c + change * r.X[:, 0])[:, None]], axis=1)
        found = problem.assessed(problem.pack(s * r.X[:, 0], fields, jnp.zeros(11)))
        return np.array([found.step, found.displacement]) / 0.8

    np.testing.assert_allclose(step(0.1, 0.2), [0.1, 0.1], rtol=1e-12)
    np.testing.assert_allclose(step(0.1, -0.8), [0.2, 0.1], rtol=1e-12)


def test_numbers_without_dimension_do_not_depend_on_the_units():
    """∫Ψ + ½γ|∇c|² of the scaled surface, times κ, is that of the surface itself."""
    energy = TwoPhase(*MODULI, line_tension=2.0, interface_width=0.5)
    problem = system(energy)
    r, phases = problem.reference, phases_of(problem.parameters)
    assert r.c is not None
    found = mixing(r.mesh, r.rule, r.X, r.c, problem.parameters) * phases.kappa
    expected = energy.mixing(r.mesh, r.X * phases.length, {"c": r.c})
    np.testing.assert_allclose(found, expected, rtol=2e-3)  # another rule of quadrature


def test_any_well_will_do():
    problem = system(TwoPhase(*MODULI, well=FloryHuggins(1.0, 3.0, 0.5)))
    v = somewhere(problem)
    direction = jr.normal(jr.key(2), v.shape)
    _, exact = jax.jvp(eqx.filter_jit(problem.residual), (v,), (direction,))
    product = eqx.filter_jit(lambda p, v: p.jacobian(v).mv(direction))(problem, v)
    np.testing.assert_allclose(product, exact, atol=1e-10)

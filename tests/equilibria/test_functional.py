"""The saddle-point system: its Jacobian, and the functional on the sphere."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.energies import AreaDifference, AreaPenalty, VolumePenalty
from jaxwillmore.equilibria._density import (
    CURVATURE,
    PRESSURE,
    TENSION,
    area_and_volume,
    integral,
)
from jaxwillmore.equilibria._functional import N_GLOBALS, EquilibriumSystem, Path
from jaxwillmore.equilibria._parameters import Parameters, Scaled, Units
from jaxwillmore.equilibria._reference import prepare, reference

from ..helpers import observed_order


def energy():
    """One that depends on area, volume and total mean curvature, with all second derivatives."""
    return AreaDifference(2.0, 0.7, 0.05) + 0.5 * VolumePenalty(3.0, 4.0) + AreaPenalty(5.0, 11.0)


def parameters(H0=0.3):
    numbers = (jnp.asarray(v) for v in (1.0, H0, 12.0, 4.0, 0.2, 0.1))
    return Parameters(*numbers, global_energy=Scaled(energy(), jnp.asarray(1.1), jnp.asarray(0.8)))


def system(level, fixed_area, fixed_volume, axes=(1.0, 1.0, 1.3)):
    mesh, x = meshes.ellipsoid(axes, level=level, degree=2)
    r = reference(mesh, *prepare(mesh), x)
    one, zero = jnp.ones(()), jnp.zeros(())
    slopes = zero, one, 0.2 * one, 0.3 * one, 0.4 * one, 0.5 * one
    nothing = jax.tree.map(jnp.zeros_like, parameters().global_energy)
    direction = Parameters(*slopes, global_energy=nothing)
    path = Path(direction, jr.normal(jr.key(0), (mesh.n_nodes,)), 0.7 * one, zero)
    flags = jnp.asarray(fixed_area), jnp.asarray(fixed_volume)
    return EquilibriumSystem(r, parameters(), path, *flags, 3.0 * one)


@pytest.mark.parametrize("fixed", [(True, False), (False, True), (False, False)])
def test_jacobian_is_the_derivative_of_the_residual(fixed):
    problem = system(0, *fixed)
    n = problem.reference.n
    keys = jr.split(jr.key(1), 4)
    s, noise = 0.01 * jr.normal(keys[0], (len(n),)), jr.normal(keys[1], n.shape)
    v = problem.pack(s, 2.0 * n + 0.1 * noise, jr.normal(keys[2], (N_GLOBALS,)))
    direction = jr.normal(keys[3], v.shape)
    _, exact = jax.jvp(eqx.filter_jit(problem.residual), (v,), (direction,))
    product = eqx.filter_jit(lambda p, v: p.jacobian(v).mv(direction))(problem, v)
    np.testing.assert_allclose(product, exact, atol=1e-11)


def test_matrix_of_the_nodal_unknowns_is_symmetric():
    problem = system(0, True, True)
    n = problem.reference.n
    v = problem.pack(jnp.zeros(len(n)), 2.0 * n, jnp.ones(N_GLOBALS))
    A = eqx.filter_jit(lambda p, v: p.blocks(v))(problem, v)
    rows, cols = (np.asarray(a) for a in (problem.pattern.rows, problem.pattern.cols))
    place = {pair: k for k, pair in enumerate(zip(rows, cols, strict=True))}
    mirrored = np.array([place[c, r] for r, c in zip(rows, cols, strict=True)])
    np.testing.assert_allclose(A, np.swapaxes(A[mirrored], 1, 2), atol=1e-12)


def shaped(problem, s, g, H=2.0):
    """The unknowns with the moment of a sphere, y = κ(H − Ĥ₀)ν with κ = 1 and Ĥ₀ = H₀ − m."""
    H0 = problem.parameters.spontaneous_curvature - g[CURVATURE]
    return problem.pack(s, (H - H0) * problem.reference.n, g)


def test_the_functional_at_its_largest_is_the_energy_with_all_loads():
    """∫ ½(H − H₀)² + mH + σ − P V on the unit sphere, up to the error of the mesh."""
    problem = system(1, True, True, axes=(1.0, 1.0, 1.0))
    sigma, P, m, H0 = 0.8, 1.7, 0.5, 0.3
    g = jnp.zeros(N_GLOBALS).at[jnp.array([TENSION, PRESSURE, CURVATURE])].set([sigma, P, m])
    s, y, _ = problem.unpack(shaped(problem, jnp.zeros(problem.reference.n.shape[0]), g))
    r = problem.reference
    fields = jnp.concatenate([r.positions(s), y], axis=1)
    found = integral(r.mesh, r.rule, fields, problem.parameters, g)
    expected = 4 * np.pi * (0.5 * (2 - H0) ** 2 + 2 * m + sigma) - P * 4 * np.pi / 3
    np.testing.assert_allclose(found, expected, rtol=3e-3)  # 162 nodes


def test_closures_vanish_at_the_slopes_of_the_energy():
    """σ = σ₀ + ∂f/∂A, P = P₀ − ∂f/∂V, m = ∂f/∂M of area, volume and ∫H as they are."""
    problem = system(0, False, False)
    p = problem.parameters
    measures = jnp.array([12.3, 4.6, 9.0])
    f_A, f_V, f_M = jax.grad(p.global_energy.of, argnums=(0, 1, 2))(*measures)
    g = jnp.zeros(N_GLOBALS).at[jnp.array([TENSION, PRESSURE, CURVATURE])]
    g = g.set(jnp.stack([p.tension + f_A, p.pressure - f_V, f_M]))
    assert min(abs(float(f)) for f in (f_A, f_V, f_M)) > 1e-2
    np.testing.assert_allclose(problem._closures(measures, g), 0.0, atol=1e-13)


def test_what_a_step_lowers_is_the_energy_and_the_work_of_what_is_applied():
    """σA − PV is part of it where area and volume are free, and not where they are held."""
    values = []
    for held in (True, False):
        problem = system(0, held, held)
        g = jnp.zeros(N_GLOBALS)
        found = problem.assessed(shaped(problem, 0.01 * problem.reference.X[:, 2], g))
        values.append(float(found.objective))
        np.testing.assert_allclose(found.step, 0.013, rtol=1e-12)
    A, V = area_and_volume(problem.reference.mesh, problem.reference.rule, found.nodes)
    np.testing.assert_allclose(values[1] - values[0], 0.2 * A - 0.1 * V, rtol=1e-10)


def test_units_make_parameters_dimensionless():
    """Lengths by L, energies by κ: each number has its power of both."""
    L, kappa = 2.0, 5.0
    numbers = (jnp.asarray(v) for v in (1.0, 3.0, 7.0, 11.0, 13.0, 17.0))
    p = Parameters(*numbers, amount=jnp.asarray(19.0))
    found = Units(jnp.asarray(L), jnp.asarray(kappa), jnp.zeros(3)).parameters(p)
    expected = (2 / kappa, 3 * L, 7 / L**2, 11 / L**3, 13 * L**2 / kappa, 17 * L**3 / kappa)
    np.testing.assert_allclose(jax.tree.leaves(found), (*expected, 19 / L**2), rtol=1e-15)


def test_functional_at_the_exact_field_converges_to_the_bending_energy_of_the_sphere():
    hs, errors = [], []
    for level in (0, 1, 2):
        problem = system(level, True, True, axes=(1.0, 1.0, 1.0))
        r = problem.reference
        y = (2.0 - 0.3) * r.X
        v = problem.pack(jnp.zeros(len(y)), y, jnp.zeros(N_GLOBALS))
        hs.append(2.0**-level)
        errors.append(abs(float(problem.energies(v)[0]) - 2 * np.pi * (2 - 0.3) ** 2))
    assert abs(observed_order(hs, errors) - 4.0) < 0.3, (hs, errors)

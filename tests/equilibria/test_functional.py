"""The saddle-point system: its Jacobian, and the functional on the sphere."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.energies import AreaDifference, AreaPenalty, VolumePenalty
from jaxwillmore.equilibria._functional import N_GLOBALS, EquilibriumSystem, Path
from jaxwillmore.equilibria._parameters import Parameters, Scaled
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

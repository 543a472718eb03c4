"""Load vectors and the consistent mass matrix."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import integrate, load, project
from jaxwillmore.mesh import ellipsoid, icosphere

from ..helpers import observed_order, taylor_remainders, with_nan


@eqx.filter_jit
def mass_times(mesh, x, u):
    return load(mesh, x, lambda _, f, phi, __: phi * f.u.value, {"u": u})


solve = eqx.filter_jit(project)


@pytest.fixture(scope="module")
def surface():
    return ellipsoid((1.0, 1.0, 2.0), 1, 2)


def test_a_load_vector_tests_with_the_basis(surface):
    mesh, x = surface
    u = jr.normal(jr.key(0), (mesh.n_nodes, 3))

    @jax.jit
    def vectors(x, u):
        ones = load(mesh, x, lambda point, f, phi, grad: phi)
        slopes = load(mesh, x, lambda point, f, phi, grad: grad)
        whole = integrate(mesh, x, lambda _, f: f.u.grad, {"u": u}, quadrature_degree=4)
        area = integrate(mesh, x, lambda _, __: jnp.ones(()), quadrature_degree=4)
        return ones, slopes, whole, area

    ones, slopes, whole, area = vectors(x, u)
    np.testing.assert_allclose(jnp.sum(ones), area, rtol=1e-13)
    # Σ u_i ∫∇φ_i = ∫∇u
    np.testing.assert_allclose(u.T @ slopes, whole, rtol=1e-11, atol=1e-12)
    # The gradients of a basis sum to zero.
    np.testing.assert_allclose(jnp.sum(slopes, axis=0), 0.0, atol=1e-12)


def test_the_mass_matrix_is_symmetric_and_positive(surface):
    mesh, x = surface
    u, v = jr.normal(jr.key(1), (2, mesh.n_nodes, 3))
    np.testing.assert_allclose(
        jnp.vdot(v, mass_times(mesh, x, u)), jnp.vdot(u, mass_times(mesh, x, v)), rtol=1e-12
    )
    assert jnp.vdot(u, mass_times(mesh, x, u)) > 0


@pytest.mark.parametrize("degree", [1, 4])
def test_projection_inverts_the_mass_matrix(degree):
    """For data of any size: the tolerance is relative."""
    mesh, x = ellipsoid((1.0, 1.0, 2.0), 0, degree)
    for size in (1.0, 1e-150, 1e150):
        u = size * jr.normal(jr.key(2), (mesh.n_nodes, 2))
        back = solve(mesh, x, mass_times(mesh, x, u))
        # The condition number of the scaled mass matrix is below 100 at every degree offered.
        np.testing.assert_allclose(back, u, atol=1e-11 * size)


def test_projection_does_not_depend_on_the_units(surface):
    """A vesicle in metres and one in micrometres: the same number of digits."""
    mesh, x = surface
    u = jr.normal(jr.key(3), (mesh.n_nodes, 3))
    for unit in (1e-9, 1e9):
        b = mass_times(mesh, unit * x, u)
        np.testing.assert_allclose(solve(mesh, unit * x, b), u, atol=1e-11)


def test_projection_of_nothing_is_nothing(surface):
    mesh, x = surface
    np.testing.assert_array_equal(solve(mesh, x, jnp.zeros_like(x)), 0.0)


@with_nan
def test_projection_of_bad_nodes_is_not_finite_but_returns(surface):
    mesh, x = surface
    out = solve(mesh, x.at[0, 0].set(jnp.nan), jnp.ones_like(x))
    assert not jnp.all(jnp.isfinite(out))


def test_derivative_of_a_projection():
    """By the nodes and by the right-hand side at once."""
    mesh, x = icosphere(0, 2)
    b = jr.normal(jr.key(4), x.shape)
    weight = jr.normal(jr.key(5), b.shape)
    f = jax.jit(lambda both: jnp.vdot(weight, jnp.sin(project(mesh, both[0], both[1]))))
    both = jnp.stack([x, b])
    direction, steps = jr.normal(jr.key(6), both.shape), (1e-3, 5e-4, 2.5e-4)
    order = observed_order(steps, taylor_remainders(f, both, direction, steps))
    assert abs(order - 2.0) < 0.1, order
    _, forward = jax.jvp(f, (both,), (direction,))
    np.testing.assert_allclose(forward, jnp.vdot(jax.grad(f)(both), direction), rtol=1e-10)


def test_projection_is_self_adjoint(surface):
    mesh, x = surface
    a, b = jr.normal(jr.key(7), (2, mesh.n_nodes, 3))
    np.testing.assert_allclose(
        jnp.vdot(a, solve(mesh, x, b)), jnp.vdot(solve(mesh, x, a), b), rtol=1e-11
    )

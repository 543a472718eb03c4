"""Integrals: exact identities, orders, symmetry, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import h1_norm, inner, integrate, integrate_by_cell, l2_norm, trace
from jaxwillmore.mesh import icosphere

from ..helpers import observed_order, random_rotation, taylor_remainders


@pytest.fixture(scope="module")
def sphere():
    return icosphere(1, 2)


@eqx.filter_jit
def second_moment(mesh, x):
    return integrate(mesh, x, lambda point, _: point.position[2] ** 2)


# 1. Closed form with order, for the two lowest degrees.
@pytest.mark.parametrize("degree, levels, expected", [(1, (1, 2, 3), 2.0), (2, (1, 2, 3), 4.0)])
def test_second_moment_of_the_sphere_converges(degree, levels, expected):
    errors = [abs(second_moment(*icosphere(level, degree)) - 4 * jnp.pi / 3) for level in levels]
    order = observed_order([2.0**-level for level in levels], errors)
    assert abs(order - expected) < 0.15, (order, errors)


# 2. Identities that hold on every discrete surface.
@pytest.mark.parametrize("degree", [1, 3])
def test_identities_of_the_discrete_surface(degree):
    mesh, x = icosphere(0, degree)
    x = x + 0.1 * jr.normal(jr.key(0), x.shape)
    c = jnp.full(mesh.n_nodes, -3.0)

    def density(point, f):
        P = jnp.eye(3) - jnp.outer(point.normal, point.normal)
        return {
            "area": jnp.ones(()),
            "trace": trace(f.x.grad),
            "defect": jnp.sum((f.x.grad - P) ** 2),
            "normal": point.normal,
        }

    @jax.jit
    def numbers(x):
        names = ("area", "trace", "defect", "normal")
        out = {n: integrate(mesh, x, lambda p, f, n=n: density(p, f)[n], {"x": x}) for n in names}
        for name, norm in (("l2", l2_norm), ("h1", h1_norm)):
            out |= {name: norm(mesh, x, x), name + "_c": norm(mesh, x, c)}
        return out

    n = numbers(x)
    # The gradient of the position is the tangential projector, which has trace 2.
    np.testing.assert_allclose(n["trace"], 2 * n["area"], rtol=1e-13)
    np.testing.assert_allclose(n["defect"], 0.0, atol=1e-24)
    np.testing.assert_allclose(n["h1"] ** 2, n["l2"] ** 2 + 2 * n["area"], rtol=1e-13)
    # A closed surface has no mean normal: ∫ν = 0, a polynomial of degree 2k - 2 cell by cell.
    np.testing.assert_allclose(n["normal"], 0.0, atol=1e-13)
    # A constant field: its value, no gradient.
    np.testing.assert_allclose(n["l2_c"], 3 * jnp.sqrt(n["area"]), rtol=1e-13)
    np.testing.assert_allclose(n["h1_c"], 3 * jnp.sqrt(n["area"]), rtol=1e-12)


def test_cells_add_up(sphere):
    mesh, x = sphere
    u = jr.normal(jr.key(1), (mesh.n_nodes, 3))

    def density(point, f):
        return inner(f.u.grad, f.u.grad) * point.position

    by_cell = jax.jit(lambda u: integrate_by_cell(mesh, x, density, {"u": u}))(u)
    whole = jax.jit(lambda u: integrate(mesh, x, density, {"u": u}))(u)
    assert by_cell.shape == (mesh.n_cells, 3)
    np.testing.assert_allclose(jnp.sum(by_cell, axis=0), whole, rtol=1e-12)


# 3. Symmetry.
def test_integrals_turn_and_scale_with_the_surface(sphere):
    mesh, x = sphere
    u, R = jr.normal(jr.key(2), (mesh.n_nodes,)), random_rotation(jr.key(3))
    moved = x @ R.T + jnp.array([[1.0, -2.0, 0.5]])

    @jax.jit
    def norms(x):
        return l2_norm(mesh, x, u), h1_norm(mesh, x, u)

    np.testing.assert_allclose(norms(moved), norms(x), rtol=1e-12)
    (l2, h1), (l2_scaled, h1_scaled) = norms(x), norms(7.0 * x)
    np.testing.assert_allclose(l2_scaled, 7 * l2, rtol=1e-12)
    # Two dimensions: the Dirichlet integral does not see the scale.
    np.testing.assert_allclose(h1_scaled**2 - l2_scaled**2, h1**2 - l2**2, rtol=1e-12)


# 4. Derivatives.
def test_derivative_of_an_integral(sphere):
    """By the nodes and by the field at once."""
    mesh, x = sphere
    u = jr.normal(jr.key(4), (mesh.n_nodes, 3))

    @jax.jit
    def f(both):
        x, u = both
        return integrate(
            mesh, x, lambda p, f: inner(f.u.grad, f.u.grad) * jnp.cos(p.normal[0]), {"u": u}
        )

    both = jnp.stack([x, u])
    direction, steps = jr.normal(jr.key(5), both.shape), (1e-3, 5e-4, 2.5e-4)
    order = observed_order(steps, taylor_remainders(f, both, direction, steps))
    assert abs(order - 2.0) < 0.1, order
    _, forward = jax.jvp(f, (both,), (direction,))
    np.testing.assert_allclose(forward, jnp.vdot(jax.grad(f)(both), direction), rtol=1e-11)


def test_vmap_equals_a_loop(sphere):
    mesh, x = sphere
    xs = jnp.stack([x, 1.1 * x])
    np.testing.assert_allclose(
        jax.jit(jax.vmap(lambda x: second_moment(mesh, x)))(xs),
        jnp.stack([second_moment(mesh, x) for x in xs]),
        rtol=1e-13,
    )

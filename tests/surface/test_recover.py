"""Normals and mean curvature from the nodes alone: identities, orders, symmetries, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import integrate, l2_norm
from jaxwillmore.mesh import ellipsoid
from jaxwillmore.surface import (
    Ellipsoid,
    mean_curvature_vector,
    recover_mean_curvature,
    recover_normal,
)

from ..helpers import observed_order, random_rotation, taylor_remainders

AXES = (1.0, 1.2, 1.5)


@eqx.filter_jit
def recovered(mesh, x):
    Y, nu, H = (f(mesh, x) for f in (mean_curvature_vector, recover_normal, recover_mean_curvature))
    return Y, nu, H


@eqx.filter_jit
def errors_of(mesh, x, normal, curvature):
    _, nu, H = recovered(mesh, x)
    return l2_norm(mesh, x, nu - normal), l2_norm(mesh, x, H - curvature)


# 1. Identities of the weak mean curvature vector, on every discrete surface.
def test_the_mean_curvature_vector_balances():
    """(Y, e_i) = (∇x, ∇e_i) = 0, and (Y, x) = (∇x, ∇x) = 2 |Γ_h|, which is Minkowski's formula."""
    mesh, x = ellipsoid(AXES, 0, 2)
    x = x + 0.05 * jr.normal(jr.key(0), x.shape)

    @jax.jit
    def numbers(x):
        Y, rule = mean_curvature_vector(mesh, x), 4  # the rule of the projection
        force = integrate(mesh, x, lambda _, f: f.Y.value, {"Y": Y}, quadrature_degree=rule)
        work = integrate(
            mesh,
            x,
            lambda _, f: jnp.sum(f.Y.value * f.x.value),
            {"Y": Y, "x": x},
            quadrature_degree=rule,
        )
        whole = integrate(mesh, x, lambda _, __: jnp.ones(()), quadrature_degree=rule)
        return force, work, whole

    force, work, whole = numbers(x)
    np.testing.assert_allclose(force, 0.0, atol=1e-11)
    np.testing.assert_allclose(work, 2 * whole, rtol=1e-11)


# 2. Orders.
def orders(degree, levels):
    exact, errors = Ellipsoid(AXES), []
    for level in levels:
        mesh, x = ellipsoid(AXES, level, degree)
        errors.append(errors_of(mesh, x, exact.normal(x), exact.mean_curvature(x)))
    hs = [2.0**-level for level in levels]
    return [observed_order(hs, column) for column in zip(*errors, strict=True)], errors


# On the smooth image of a regular mesh normals gain half an order, from 1 and 3.
def test_quadratic_ellipsoid_converges():
    (normal, curvature), errors = orders(2, (2, 3))
    assert abs(normal - 3.5) < 0.15, errors
    assert abs(curvature - 2.0) < 0.15, errors


@pytest.mark.slow
def test_linear_ellipsoid_converges():
    (normal, curvature), errors = orders(1, (2, 3, 4))
    assert abs(normal - 1.5) < 0.15, errors
    assert abs(curvature - 1.05) < 0.15, errors  # on a regular mesh only


def test_recovered_normals_point_outward_and_have_unit_length():
    mesh, x = ellipsoid(AXES, 1, 2)
    _, nu, H = recovered(mesh, x)
    np.testing.assert_allclose(jnp.linalg.norm(nu, axis=1), 1.0, rtol=1e-14)
    assert jnp.min(jnp.sum(nu * Ellipsoid(AXES).normal(x), axis=1)) > 0.99
    assert jnp.min(H) > 0  # H = κ₁ + κ₂ is positive on a convex body


# 3. Symmetries.
def test_recovered_fields_turn_and_scale_with_the_surface():
    mesh, x = ellipsoid(AXES, 1, 2)
    x = x + 0.02 * jr.normal(jr.key(1), x.shape)
    R, b = random_rotation(jr.key(2)), jnp.array([[1.0, -2.0, 0.5]])
    Y, nu, H = recovered(mesh, x)
    moved = recovered(mesh, x @ R.T + b)
    scaled = recovered(mesh, 3.0 * x)
    close = {"rtol": 1e-10, "atol": 1e-10}
    for found, expected in zip(moved, (Y @ R.T, nu @ R.T, H), strict=True):
        np.testing.assert_allclose(found, expected, **close)
    for found, expected in zip(scaled, (Y / 3, nu, H / 3), strict=True):
        np.testing.assert_allclose(found, expected, **close)


# 4. Derivatives.
def test_derivative_of_recovered_fields():
    """Of the recovered H = Y·ν, which passes through both projections."""
    mesh, x = ellipsoid(AXES, 1, 2)
    weight, phi = jr.normal(jr.key(3), (mesh.n_nodes,)), jr.normal(jr.key(4), x.shape)
    f = jax.jit(lambda x: jnp.vdot(weight, recover_mean_curvature(mesh, x)))
    steps = (1e-3, 5e-4, 2.5e-4)
    order = observed_order(steps, taylor_remainders(f, x, phi, steps))
    assert abs(order - 2.0) < 0.1, order
    _, forward = jax.jvp(f, (x,), (phi,))
    np.testing.assert_allclose(forward, jnp.vdot(jax.grad(f)(x), phi), rtol=1e-10)

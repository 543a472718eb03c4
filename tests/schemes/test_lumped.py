"""Lumped quantities against closed forms, and the first variation against the energy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.fem import Jet, inner, load
from jaxwillmore.schemes._dziuk_willmore import area_variation, divergence_variation
from jaxwillmore.schemes._lumped import (
    lumped_mean_curvature,
    lumped_weingarten_squared,
    vertex_geometry,
    vertex_rule,
)

# Operation by operation these would take seconds.
area = eqx.filter_jit(jw.surface.area)
geometry = eqx.filter_jit(vertex_geometry)
mean_curvature = eqx.filter_jit(lumped_mean_curvature)
weingarten_squared = eqx.filter_jit(lumped_weingarten_squared)


def test_lumped_masses_sum_to_the_area_and_normals_to_nothing():
    mesh, x = jw.mesh.ellipsoid((1.0, 1.2, 1.5), 1, degree=1)
    m, omega, stiff = geometry(mesh, x)
    np.testing.assert_allclose(jnp.sum(m), area(mesh, x), rtol=1e-13)
    np.testing.assert_allclose(jnp.sum(m[:, None] * omega, axis=0), 0, atol=1e-13)
    np.testing.assert_allclose(jnp.sum(stiff, axis=0), 0, atol=1e-13)
    # (∇x, ∇x) is twice the area.
    np.testing.assert_allclose(jnp.sum(stiff * x), 2 * area(mesh, x), rtol=1e-13)
    # The gradient of the area, (∇x, ∇φ).
    gradient = jax.jit(jax.grad(lambda x: jw.surface.area(mesh, x)))(x)
    np.testing.assert_allclose(stiff, gradient, atol=1e-13)


@pytest.mark.parametrize("R", [1.0, 2.0])
def test_curvatures_of_a_sphere_are_of_second_order_in_the_mesh(R):
    """In the mean over the surface: at single vertices they depend on how regular the fan is."""
    errors = []
    for level in (1, 2, 3):
        mesh, x = jw.mesh.icosphere(level, degree=1, radius=R)
        H = mean_curvature(mesh, x)
        A2 = weingarten_squared(mesh, x, H)
        m, _, _ = geometry(mesh, x)
        errors.append([float(jnp.sum(m * e) / jnp.sum(m)) for e in (H - 2 / R, A2 - 2 / R**2)])
    orders = np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


def test_the_weingarten_map_of_an_ellipsoid():
    """But for the twelve vertices of valence 5, where a third of the star is not the dual cell."""
    surface = jw.surface.Ellipsoid(jnp.array([1.0, 1.2, 1.5]))
    mesh, x = jw.mesh.ellipsoid((1.0, 1.2, 1.5), 3, degree=1)
    A2 = weingarten_squared(mesh, x, mean_curvature(mesh, x))
    exact = jnp.sum(surface.weingarten(x) ** 2, axis=(1, 2))
    np.testing.assert_allclose(A2[12:], exact[12:], rtol=0.12)
    np.testing.assert_allclose(jnp.mean(A2 / exact), 1.0, atol=0.02)


def test_the_vertex_rule_integrates_linear_functions():
    mesh, x = jw.mesh.icosphere(0, degree=1)
    rule = vertex_rule(mesh)
    np.testing.assert_allclose(jnp.sum(rule.weights), 0.5, rtol=1e-15)
    np.testing.assert_allclose(rule.phi[:, :, 0], np.eye(3), atol=1e-15)


@pytest.mark.parametrize("degree, level", [(1, 1), (2, 0)])
def test_the_first_variation_is_the_gradient_of_the_discrete_energy(degree, level):
    r"""$\delta\int(\nabla\cdot Y - \tfrac12|Y|^2)[\varphi]$ at fixed Y; Y itself is optimal."""
    mesh, x = jw.mesh.ellipsoid((1.0, 1.2, 1.5), level, degree=degree)
    Y = jw.surface.mean_curvature_vector(mesh, x)

    def tested(point, f, phi, grad):
        P = jnp.eye(3) - jnp.outer(point.normal, point.normal)
        surface = Jet(point.position, P)

        def component(e):
            chi = Jet(phi * e, jnp.outer(e, grad))
            half_square = 0.5 * inner(f.Y.value, f.Y.value)
            return divergence_variation(f.Y, point, chi) - half_square * area_variation(
                surface, chi
            )

        return jax.vmap(component)(jnp.eye(3))

    rule = 2 * degree
    variation = jax.jit(lambda x: load(mesh, x, tested, {"Y": Y}, quadrature_degree=rule))(x)

    def energy(x):
        def density(point, f):
            return jnp.trace(f.Y.grad) - 0.5 * inner(f.Y.value, f.Y.value)

        return jw.fem.integrate(mesh, x, density, {"Y": Y}, quadrature_degree=rule)

    np.testing.assert_allclose(variation, jax.jit(jax.grad(energy))(x), atol=1e-12)
    if degree == 1:  # then all rules are exact, and the whole derivative is that at fixed Y
        whole = jax.jit(jax.grad(lambda x: jw.energies.Willmore()(mesh, x)))(x)
        np.testing.assert_allclose(variation, whole, atol=1e-11)

"""Exact geometry: closed forms, Gauss–Bonnet, known energies, projection."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.reference import lagrange_basis, lagrange_gradients, quadrature
from jaxwillmore.shapes import SHAPES, make_shape


def integrate(mesh, x, function):
    """∫ of a function of the points of a fine mesh of degree 4, on the host."""
    rule, cells = quadrature(10), np.asarray(mesh.cells)
    corners = np.asarray(x)[cells]
    points = np.einsum("ql,tld->tqd", lagrange_basis(4, rule.points), corners)
    J = np.einsum("qla,tld->tqad", lagrange_gradients(4, rule.points), corners)
    dA = np.linalg.norm(np.cross(J[:, :, 0], J[:, :, 1]), axis=-1) * rule.weights
    return float(np.sum(np.asarray(function(jnp.asarray(points.reshape(-1, 3)))) * dA.ravel()))


def test_sphere_has_closed_forms():
    _, x = jw.mesh.icosphere(1, degree=2, radius=3.0)
    sphere = jw.surface.Sphere(radius=3.0)
    np.testing.assert_allclose(sphere.normal(x), x / 3, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(sphere.mean_curvature(x), 2 / 3, rtol=1e-14)
    np.testing.assert_allclose(sphere.gaussian_curvature(x), 1 / 9, rtol=1e-14)
    np.testing.assert_allclose(sphere.mean_curvature_gradient(x), 0.0, atol=1e-14)
    P = jnp.eye(3)[None] - x[:, :, None] * x[:, None, :] / 9
    np.testing.assert_allclose(sphere.weingarten(x), P / 3, atol=1e-15)


def test_torus_has_closed_forms():
    R, r = 1.3, 0.5
    theta, phi = jnp.asarray(np.random.default_rng(0).uniform(0, 2 * np.pi, (2, 30)))
    rho = R + r * jnp.cos(phi)
    e_rho = jnp.stack([jnp.cos(theta), jnp.sin(theta), 0 * theta], axis=1)
    e_z = jnp.array([[0.0, 0.0, 1.0]])
    x = rho[:, None] * e_rho + r * jnp.sin(phi)[:, None] * e_z
    torus = jw.surface.Torus(R, r)
    nu = jnp.cos(phi)[:, None] * e_rho + jnp.sin(phi)[:, None] * e_z
    np.testing.assert_allclose(torus.normal(x), nu, atol=1e-14)
    np.testing.assert_allclose(torus.mean_curvature(x), 1 / r + jnp.cos(phi) / rho, rtol=1e-13)
    np.testing.assert_allclose(
        torus.gaussian_curvature(x), jnp.cos(phi) / (r * rho), rtol=1e-12, atol=1e-14
    )
    # H changes along φ only, where arc length is r φ.
    slope = jax.vmap(jax.grad(lambda t: jnp.cos(t) / (R + r * jnp.cos(t))))(phi) / r
    tangent = -jnp.sin(phi)[:, None] * e_rho + jnp.cos(phi)[:, None] * e_z
    gradient = slope[:, None] * tangent
    np.testing.assert_allclose(torus.mean_curvature_gradient(x), gradient, atol=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_energy_and_gauss_bonnet(name):
    mesh, x, exact = make_shape(name, level=3, degree=4)
    energy = integrate(mesh, x, lambda p: 0.5 * exact.mean_curvature(exact.project(p)) ** 2)
    np.testing.assert_allclose(energy, SHAPES[name].willmore, rtol=2e-6)
    total = integrate(mesh, x, lambda p: exact.gaussian_curvature(exact.project(p)))
    np.testing.assert_allclose(total, 2 * np.pi * mesh.euler_characteristic, atol=1e-5)


@pytest.mark.parametrize("name", SHAPES)
def test_weingarten_map_is_symmetric_and_kills_the_normal(name):
    _, x, exact = make_shape(name, level=0, degree=2)
    A = exact.weingarten(x)
    scale = float(jnp.abs(A).max())
    np.testing.assert_allclose(A, jnp.swapaxes(A, 1, 2), atol=1e-13 * scale)
    normal = exact.normal(x)
    np.testing.assert_allclose(jnp.einsum("nij,nj->ni", A, normal), 0.0, atol=1e-13 * scale)
    gradient = exact.mean_curvature_gradient(x)
    size = float(jnp.abs(gradient).max()) + scale
    np.testing.assert_allclose(jnp.sum(gradient * normal, axis=1), 0.0, atol=1e-12 * size)


@pytest.mark.parametrize("name", SHAPES)
def test_projection_reaches_the_surface_and_leaves_it_alone(name):
    mesh, x, exact = make_shape(name, level=1, degree=1)
    h = jw.mesh.quality(mesh, x).h_min
    np.testing.assert_allclose(exact.project(x), x, atol=1e-14 * float(jnp.abs(x).max()))
    away = x + 0.1 * h * jnp.asarray(np.random.default_rng(1).uniform(-1, 1, x.shape))
    back = exact.project(away)
    slope = jnp.linalg.norm(jax.vmap(jax.grad(exact))(back), axis=1)
    distance = jnp.abs(exact.value(back)) / slope
    assert float(distance.max()) < 1e-14 * float(jnp.abs(x).max())


def test_projection_from_a_hopeless_place_is_an_error():
    with pytest.raises(Exception, match="did not reach the surface"):
        jw.surface.Sphere().project(jnp.zeros((1, 3)))


def test_any_function_makes_a_level_set():
    a = jw.surface.LevelSet(lambda p: jnp.sum((p / jnp.array([1.0, 1.0, 2.0])) ** 2) - 1.0)
    _, x = jw.mesh.ellipsoid(level=0, degree=2)
    b = jw.surface.Ellipsoid()
    np.testing.assert_allclose(a.mean_curvature(x), b.mean_curvature(x), rtol=1e-13)


def test_curvature_is_differentiable_in_the_parameters():
    point = jnp.array([[0.0, 0.0, 1.0]])
    slope = jax.grad(lambda R: jw.surface.Sphere(R).mean_curvature(R * point)[0])(2.0)
    np.testing.assert_allclose(slope, -0.5, rtol=1e-14)  # d(2/R)/dR at R = 2


def test_impossible_lengths_are_refused():
    with pytest.raises(ValueError, match="positive"):
        jw.surface.Sphere(radius=-1.0)
    with pytest.raises(ValueError, match="three positive lengths"):
        jw.surface.Ellipsoid(semi_axes=(1.0, 2.0))

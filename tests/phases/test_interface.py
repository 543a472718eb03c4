"""The length of the line between two phases: circles on a sphere, order, derivatives."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.mesh import SurfaceMesh, ellipsoid, icosphere
from jaxwillmore.phases import interface_length

from ..helpers import observed_order, random_rotation, taylor_remainders

# No axis of an icosahedron, so that the line crosses cells in every way.
AXIS = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])


def cap(x, theta, width=0.5):
    return jax.nn.sigmoid((theta - jnp.arccos(jnp.clip(x @ AXIS, -1.0, 1.0))) / width)


@pytest.mark.parametrize("degree, error", [(1, 6e-2), (2, 5e-3), (3, 2e-3)])
def test_the_edge_of_a_cap_is_a_circle(degree, error):
    """2π sin θ; inscribed polygons are short by h²/24 in the length of their pieces."""
    mesh, x = icosphere(1, degree)
    for theta in (0.7, 1.4):
        found = interface_length(mesh, x, cap(x, theta))
        assert 0 < 1 - found / (2 * np.pi * np.sin(theta)) < error


@pytest.mark.parametrize("degree", [1, 2])
def test_the_length_is_of_second_order(degree):
    """The way in which the line crosses a mesh blurs the order."""
    hs, errors = (1.0, 0.5, 0.25), []
    for level in (1, 2, 3):
        mesh, x = icosphere(level, degree)
        thetas = (0.6, 0.8, 1.0, 1.2, 1.4)
        found = [interface_length(mesh, x, cap(x, t)) / (2 * np.pi * np.sin(t)) for t in thetas]
        errors.append(float(np.mean(np.abs(np.array(found) - 1))))
    assert abs(observed_order(hs, errors) - 2) < 0.2, errors


def test_on_flat_cells_a_plane_cuts_exactly():
    """A tetrahedron of edges √2, cut halfway between two opposite edges: a square of sides ½√2."""
    mesh = SurfaceMesh(np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]), 1, 4)
    x = 0.5 * jnp.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    np.testing.assert_allclose(interface_length(mesh, x, x[:, 0], 0.0), 2 * 2**0.5, rtol=1e-14)


def test_the_length_ignores_rigid_motion_and_scales():
    mesh, x = icosphere(0, 1)
    R = random_rotation(jr.key(0))
    level = jnp.asarray(0.2)
    lengths = [interface_length(mesh, y, x[:, 2], level) for y in (x, x @ R.T, 2 * x)]
    np.testing.assert_allclose(lengths[1], lengths[0], rtol=1e-13)
    np.testing.assert_allclose(lengths[2], 2 * lengths[0], rtol=1e-13)


def test_both_phases_have_the_same_edge():
    mesh, x = ellipsoid((1.0, 1.2, 1.5), 0, 2)
    c = cap(x, 1.1)
    np.testing.assert_allclose(
        interface_length(mesh, x, 1 - c), interface_length(mesh, x, c), rtol=1e-12
    )


def test_one_phase_has_no_edge():
    mesh, x = icosphere(0, 2)
    for c in (jnp.zeros(42), jnp.ones(42), jnp.full(42, 0.5)):
        value, slope = jax.value_and_grad(lambda c: interface_length(mesh, x, c))(c)
        assert value == 0 and jnp.all(slope == 0)


def test_the_length_has_derivatives_by_the_level_and_the_nodes():
    """Of the level of c = z on the unit sphere: L = 2π√(1 − z²), dL/dz = −2πz/√(1 − z²); by x it
    is homogeneous of degree one."""
    mesh, x = icosphere(2, 2)
    length = jax.jit(lambda x, c, level: interface_length(mesh, x, c, level))
    z = jnp.asarray(0.43)
    slope = jax.jit(jax.grad(length, argnums=2))(x, x[:, 2], z)
    np.testing.assert_allclose(slope, -2 * np.pi * z / np.sqrt(1 - z**2), rtol=2e-2)
    value, by_nodes = length(x, x[:, 2], z), jax.jit(jax.grad(length))(x, x[:, 2], z)
    np.testing.assert_allclose(jnp.vdot(by_nodes, x), value, rtol=1e-12)


def test_the_taylor_remainder_is_quadratic():
    mesh, x = icosphere(0, 2)
    direction, steps = (
        0.1 * jr.normal(jr.key(1), (42,)),
        (4e-4, 2e-4, 1e-4),
    )  # before the line meets a corner
    f = jax.jit(lambda c: interface_length(mesh, x, c))
    order = observed_order(steps, taylor_remainders(f, cap(x, 1.03), direction, steps))
    assert abs(order - 2) < 0.1, order

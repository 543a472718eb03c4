"""Shape functions: nodal, complete, and with the right derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.reference import lagrange_basis, lagrange_gradients, lagrange_nodes

DEGREES = (1, 2, 3, 4)
POINTS = np.random.default_rng(0).dirichlet((1.0, 1.0, 1.0), size=20)[:, 1:]


@pytest.mark.parametrize("degree", DEGREES)
def test_basis_is_nodal(degree):
    values = lagrange_basis(degree, lagrange_nodes(degree))
    np.testing.assert_allclose(values, np.eye((degree + 1) * (degree + 2) // 2), atol=1e-13)


@pytest.mark.parametrize("degree", DEGREES)
def test_basis_is_a_partition_of_unity(degree):
    np.testing.assert_allclose(lagrange_basis(degree, POINTS).sum(axis=-1), 1.0, rtol=1e-13)
    np.testing.assert_allclose(lagrange_gradients(degree, POINTS).sum(axis=-2), 0.0, atol=1e-12)


@pytest.mark.parametrize("degree", DEGREES)
def test_basis_reproduces_polynomials_of_its_degree_and_no_more(degree):
    nodes = lagrange_nodes(degree)
    for i in range(degree + 2):
        monomial = lambda xi, i=i: xi[:, 0] ** i * xi[:, 1] ** (degree + 1 - i)
        error = np.abs(lagrange_basis(degree, POINTS) @ monomial(nodes) - monomial(POINTS)).max()
        assert error > 1e-3
        for j in range(degree + 1 - i):
            monomial = lambda xi, i=i, j=j: xi[:, 0] ** i * xi[:, 1] ** j
            interpolated = lagrange_basis(degree, POINTS) @ monomial(nodes)
            np.testing.assert_allclose(interpolated, monomial(POINTS), atol=1e-13)


@pytest.mark.parametrize("degree", DEGREES)
def test_gradients_are_the_derivatives_of_the_basis(degree):
    nodes, xi = lagrange_nodes(degree), POINTS[0]
    # The basis in monomials, from its values at the nodes, differentiated by JAX.
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    vandermonde = np.stack([nodes[:, 0] ** i * nodes[:, 1] ** j for i, j in powers], axis=1)
    coefficients = jnp.asarray(np.linalg.inv(vandermonde))

    def basis(xi):
        return jnp.stack([xi[0] ** i * xi[1] ** j for i, j in powers]) @ coefficients

    expected = jax.jacfwd(basis)(jnp.asarray(xi))
    np.testing.assert_allclose(lagrange_gradients(degree, xi), expected, atol=1e-11)


def test_local_order_is_vertices_then_edges_then_interior():
    nodes = lagrange_nodes(4)
    np.testing.assert_array_equal(nodes[:3], [(0, 0), (1, 0), (0, 1)])
    np.testing.assert_array_equal(nodes[3:6], [(0.25, 0), (0.5, 0), (0.75, 0)])
    np.testing.assert_array_equal(nodes[6:9], [(0.75, 0.25), (0.5, 0.5), (0.25, 0.75)])
    np.testing.assert_array_equal(nodes[9:12], [(0, 0.75), (0, 0.5), (0, 0.25)])
    np.testing.assert_array_equal(nodes[12:], [(0.25, 0.25), (0.5, 0.25), (0.25, 0.5)])


def test_points_may_have_any_leading_axes():
    xi = POINTS.reshape(4, 5, 2)
    assert lagrange_basis(3, xi).shape == (4, 5, 10)
    assert lagrange_gradients(3, xi).shape == (4, 5, 10, 2)
    np.testing.assert_array_equal(lagrange_gradients(3, xi)[2, 3], lagrange_gradients(3, xi[2, 3]))


@pytest.mark.parametrize("degree", [0, 5, -1])
def test_other_degrees_are_refused(degree):
    with pytest.raises(ValueError, match="must be 1, 2, 3 or 4"):
        lagrange_nodes(degree)

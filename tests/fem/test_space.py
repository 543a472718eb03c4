"""The tabulated Lagrange space: partition of unity, and gather against scatter."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import gather, rule_for, scatter_add
from jaxwillmore.mesh import icosphere


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_the_table_is_a_partition_of_unity(degree):
    mesh, _ = icosphere(0, degree)
    rule = rule_for(mesh)
    np.testing.assert_allclose(jnp.sum(rule.weights), 0.5, rtol=1e-14)
    np.testing.assert_allclose(jnp.sum(rule.phi[:, :, 0], axis=1), 1.0, rtol=1e-13)
    np.testing.assert_allclose(jnp.sum(rule.phi[:, :, 1:], axis=1), 0.0, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_the_default_rule_integrates_products_of_the_basis(degree):
    """Exactness 2k: the reference mass matrix is that of the finest rule."""
    mesh, _ = icosphere(0, degree)

    def mass(rule):
        phi = rule.phi[:, :, 0]
        return jnp.einsum("q,qi,qj->ij", rule.weights, phi, phi)

    np.testing.assert_allclose(mass(rule_for(mesh)), mass(rule_for(mesh, 10)), atol=1e-15)


@pytest.mark.parametrize("trailing", [(), (3,), (2, 2)])
def test_scatter_is_the_transpose_of_gather(trailing):
    mesh, _ = icosphere(1, 2)
    nodal = jr.normal(jr.key(0), (mesh.n_nodes, *trailing))
    local = jr.normal(jr.key(1), (*mesh.cells.shape, *trailing))
    np.testing.assert_allclose(
        jnp.vdot(gather(mesh, nodal), local), jnp.vdot(nodal, scatter_add(mesh, local)), rtol=1e-12
    )


def test_a_rule_beyond_the_tables_is_an_error():
    mesh, _ = icosphere(0, 1)
    with pytest.raises(ValueError):
        rule_for(mesh, 11)

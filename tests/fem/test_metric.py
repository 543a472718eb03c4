"""The metric at one point: identities of linear algebra for any Jacobian."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import Jet, inner, point, sym, trace

from ..helpers import random_rotation


@pytest.fixture
def J():
    return jr.normal(jr.key(0), (3, 2))


def test_area_element_normal_and_lift(J):
    here = point(jnp.zeros(3), J)
    np.testing.assert_allclose(here.dA, jnp.sqrt(jnp.linalg.det(J.T @ J)), rtol=1e-13)
    np.testing.assert_allclose(jnp.linalg.norm(here.normal), 1.0, rtol=1e-14)
    np.testing.assert_allclose(J.T @ here.normal, 0.0, atol=1e-14)
    # J G⁻¹: dual to the tangent vectors, and a projector together with them.
    np.testing.assert_allclose(here.lift.T @ J, np.eye(2), atol=1e-13)
    P = jnp.eye(3) - jnp.outer(here.normal, here.normal)
    np.testing.assert_allclose(J @ here.lift.T, P, atol=1e-13)
    # The normal follows the right hand from the first to the second tangent.
    assert jnp.linalg.det(jnp.column_stack([J, here.normal])) > 0


def test_metric_turns_with_the_surface(J):
    R = random_rotation(jr.key(1))
    here, turned = point(jnp.ones(3), J), point(R @ jnp.ones(3), R @ J)
    np.testing.assert_allclose(turned.dA, here.dA, rtol=1e-13)
    np.testing.assert_allclose(turned.normal, R @ here.normal, atol=1e-14)
    np.testing.assert_allclose(turned.lift, R @ here.lift, atol=1e-13)


def test_metric_does_not_depend_on_the_reference_triangle(J):
    """Other parameters ξ = B η of the same tangent plane: the same tangential gradient."""
    B = jnp.array([[2.0, 0.3], [-0.5, 1.0]])
    du = jnp.array([0.7, -1.1])
    here, other = point(jnp.zeros(3), J), point(jnp.zeros(3), J @ B)
    np.testing.assert_allclose(other.lift @ (B.T @ du), here.lift @ du, rtol=1e-12)
    np.testing.assert_allclose(other.dA, here.dA * jnp.linalg.det(B), rtol=1e-13)
    np.testing.assert_allclose(other.normal, here.normal, atol=1e-14)


def test_first_variation_of_the_area_element(J):
    """δ dA = dA div_Γ φ for every variation φ of the position, whatever its direction."""
    D = jr.normal(jr.key(2), (3, 2))
    _, slope = jax.jvp(lambda J: point(jnp.zeros(3), J).dA, (J,), (D,))
    here = point(jnp.zeros(3), J)
    np.testing.assert_allclose(slope, here.dA * trace(D @ here.lift.T), rtol=1e-12)


def test_algebra_of_gradients():
    a, b = jr.normal(jr.key(3), (2, 3, 3))
    np.testing.assert_allclose(inner(a, b), np.trace(a.T @ b), rtol=1e-13)
    np.testing.assert_allclose(trace(a), np.trace(a), rtol=1e-14)
    np.testing.assert_allclose(sym(a), sym(a).T, atol=0)
    np.testing.assert_allclose(sym(a) + 0.5 * (a - a.T), a, atol=1e-15)


def test_a_jet_refuses_a_gradient_without_three_components():
    with pytest.raises(TypeError):
        Jet(jnp.zeros(()), jnp.zeros(2))

"""Curvatures from a normal field: exact on spheres, convergent on a torus, safe at umbilics."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from jaxwillmore.fem import Jet, inner, integrate, trace
from jaxwillmore.mesh import icosphere, torus
from jaxwillmore.surface import (
    Torus,
    gaussian_curvature,
    nodal_weingarten_squared,
    principal_curvatures,
    weingarten,
)

from ..helpers import observed_order


def symmetric(key, kappa1, kappa2):
    """A Weingarten map with given principal curvatures and a random frame."""
    Q, _ = jnp.linalg.qr(jr.normal(key, (3, 3)))
    return kappa1 * jnp.outer(Q[0], Q[0]) + kappa2 * jnp.outer(Q[1], Q[1])


def test_principal_curvatures_come_back_from_their_sums():
    for kappa1, kappa2 in ((2.0, 0.5), (1.0, -3.0), (-0.5, -4.0), (1.5, 1.5)):
        A = symmetric(jr.key(0), kappa1, kappa2)
        np.testing.assert_allclose(gaussian_curvature(A), kappa1 * kappa2, rtol=1e-13)
        found = principal_curvatures(trace(A), inner(A, A))
        # At the umbilic, κ₁ - κ₂ is the root of a difference that rounds to about 1e-16.
        np.testing.assert_allclose(
            found, (kappa1, kappa2), atol=1e-7 if kappa1 == kappa2 else 1e-13
        )


def test_principal_curvatures_have_derivatives_at_umbilics():
    slopes = jax.jacobian(principal_curvatures, argnums=(0, 1))(jnp.asarray(2.0), jnp.asarray(2.0))
    assert all(bool(jnp.isfinite(s)) for s in jax.tree.leaves(slopes))
    sums = jax.grad(lambda H, A2: sum(principal_curvatures(H, A2)))(
        jnp.asarray(2.0), jnp.asarray(2.0)
    )
    np.testing.assert_allclose(sums, 1.0)  # κ₁ + κ₂ = H everywhere


def test_the_weingarten_map_is_the_symmetric_part():
    nu = Jet(jnp.array([0.0, 0.0, 1.0]), jr.normal(jr.key(1), (3, 3)))
    A = weingarten(nu)
    np.testing.assert_array_equal(A, A.T)
    np.testing.assert_allclose(2 * A - nu.grad, nu.grad.T, atol=1e-15)


def test_spheres_are_exact():
    """ν = x/R makes ∇ν = P/R on the discrete surface too: |A|² = 2/R², K = 1/R²."""
    mesh, x = icosphere(1, 2, 3.0)

    @jax.jit
    def numbers(x):
        def density(_, f):
            return jnp.stack([gaussian_curvature(weingarten(f.nu)), jnp.ones(())])

        sums = integrate(mesh, x, density, {"nu": x / 3})
        return nodal_weingarten_squared(mesh, x, x / 3), sums

    A2, (total, whole) = numbers(x)
    np.testing.assert_allclose(A2, 2 / 9, rtol=1e-12)
    np.testing.assert_allclose(total, whole / 9, rtol=1e-13)


def test_weingarten_squared_and_gauss_bonnet_converge_on_a_torus():
    exact, squared, total = Torus(1.0, 0.5), [], []

    @eqx.filter_jit
    def numbers(mesh, x, nu):
        K = integrate(mesh, x, lambda _, f: gaussian_curvature(weingarten(f.nu)), {"nu": nu})
        return nodal_weingarten_squared(mesh, x, nu), K

    for level in (1, 2):
        mesh, x = torus(1.0, 0.5, level=level, degree=2)
        A2, K = numbers(mesh, x, exact.normal(x))
        A = exact.weingarten(x)
        squared.append(jnp.max(jnp.abs(A2 - jnp.sum(A * A, axis=(1, 2)))))
        total.append(abs(K))
        assert jnp.min(A2) > 0
    # A mean over the neighbourhood of a node: order 2, the highest a mean can have.
    assert abs(observed_order((1.0, 0.5), squared) - 2.0) < 0.3, squared
    assert total[-1] < 1e-2 and observed_order((1.0, 0.5), total) > 1.85, total

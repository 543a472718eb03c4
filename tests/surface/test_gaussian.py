"""Gaussian curvature as a measure: Gauss–Bonnet, angle defects, known surfaces, order."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import integrate
from jaxwillmore.mesh import ellipsoid, icosphere, torus
from jaxwillmore.surface import Ellipsoid, gaussian_curvature_load, recover_gaussian_curvature

load = jax.jit(gaussian_curvature_load)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_gauss_bonnet_holds_to_rounding_on_every_mesh(degree):
    """2πχ = 4π and 0, also where the nodes are moved at random."""
    for (mesh, x), expected in (
        (icosphere(0, degree), 4 * np.pi),
        (torus(1.0, 0.5, level=0, degree=degree), 0.0),
    ):
        rough = x + 0.03 * jr.normal(jr.key(degree), x.shape)
        np.testing.assert_allclose(jnp.sum(load(mesh, rough)), expected, atol=1e-11)


def test_flat_triangles_have_the_angle_defect():
    mesh, x = ellipsoid((1.0, 1.2, 1.5), 1, 1)
    corners = np.asarray(x)[np.asarray(mesh.cells)]
    defect = np.full(mesh.n_nodes, 2 * np.pi)
    for k in range(3):
        a = corners[:, (k + 1) % 3] - corners[:, k]
        b = corners[:, (k + 2) % 3] - corners[:, k]
        cosine = np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        np.subtract.at(defect, np.asarray(mesh.cells)[:, k], np.arccos(cosine))
    np.testing.assert_allclose(load(mesh, x), defect, atol=1e-12)


def test_the_measure_does_not_see_motion_or_scale():
    mesh, x = ellipsoid((1.0, 1.2, 1.5), 0, 2)
    R, _ = jnp.linalg.qr(jr.normal(jr.key(1), (3, 3)))
    R = R * jnp.sign(jnp.linalg.det(R))
    moved = 7.0 * x @ R.T + jnp.array([[1.0, -2.0, 0.5]])
    np.testing.assert_allclose(load(mesh, moved), load(mesh, x), atol=1e-12)


def errors(level):
    """∫ w dK of a triaxial ellipsoid against the exact curvature, and K_h in L²."""
    axes = (1.0, 1.2, 1.5)
    mesh, x = ellipsoid(axes, level, 2)
    K, K_h = Ellipsoid(axes).gaussian_curvature(x), recover_gaussian_curvature(mesh, x)
    w = jnp.exp(0.5 * x[:, 0]) * (1 + x[:, 1] * x[:, 2]) + x[:, 2] ** 3

    def density(_, f):
        return jnp.stack([f.w.value * f.K.value, (f.K_h.value - f.K.value) ** 2])

    exact, square = integrate(mesh, x, density, {"w": w, "K": K, "K_h": K_h})
    return abs(float(jnp.vdot(w, load(mesh, x)) - exact)), float(jnp.sqrt(square))


def test_integrals_converge_with_order_four_and_the_field_with_order_two():
    coarse, fine = errors(1), errors(2)
    assert fine[0] < 1e-4 * 13, fine
    assert np.log2(coarse[0] / fine[0]) > 3.3
    assert abs(np.log2(coarse[1] / fine[1]) - 2.0) < 0.3

"""Area, volume and what follows from them: exact values, orders, invariance, first variations."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.mesh import SurfaceMesh, icosphere, red_cell
from jaxwillmore.surface import area, area_radius, centroid, reduced_volume, volume

from ..helpers import observed_order, random_rotation, taylor_remainders


@eqx.filter_jit
def measures(mesh, x):
    return {
        "area": area(mesh, x),
        "volume": volume(mesh, x),
        "centroid": centroid(mesh, x),
        "reduced_volume": reduced_volume(mesh, x),
        "area_radius": area_radius(mesh, x),
    }


# 1. Closed forms.
def test_a_tetrahedron_is_measured_exactly():
    x = jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    cells = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    mesh = SurfaceMesh(cells=jnp.asarray(cells), degree=1, n_nodes=4)
    m = measures(mesh, x)
    whole = 1.5 + np.sqrt(3) / 2
    np.testing.assert_allclose(m["area"], whole, rtol=1e-14)
    np.testing.assert_allclose(m["volume"], 1 / 6, rtol=1e-14)
    # Centre of area: three right triangles (½ each) and the slanted one (√3/2).
    centre = (2 * 0.5 / 3 + np.sqrt(3) / 2 / 3) / whole
    np.testing.assert_allclose(m["centroid"], np.full(3, centre), rtol=1e-13)
    # Turned inside out, the volume changes its sign and nothing else changes.
    inward = SurfaceMesh(cells=jnp.asarray(cells[:, [0, 2, 1]]), degree=1, n_nodes=4)
    np.testing.assert_allclose(measures(inward, x)["volume"], -1 / 6, rtol=1e-14)
    np.testing.assert_allclose(measures(inward, x)["area"], whole, rtol=1e-14)


@pytest.mark.parametrize("degree, expected", [(1, 2.0), (2, 4.0)])  # P2 gains one order
def test_sphere_converges(degree, expected):
    found = [measures(*icosphere(level, degree)) for level in (1, 2, 3)]
    for name, exact in (
        ("area", 4 * np.pi),
        ("volume", 4 * np.pi / 3),
        ("area_radius", 1.0),
    ):
        errors = [abs(m[name] - exact) for m in found]
        order = observed_order((1.0, 0.5, 0.25), errors)
        assert abs(order - expected) < 0.15, (name, order, errors)
    # The isoperimetric deficit is quadratic in the error of the normals: O(h) and O(h³).
    deficits = [1 - m["reduced_volume"] for m in found]
    order = observed_order((1.0, 0.5, 0.25), deficits)
    assert abs(order - (2.0 if degree == 1 else 6.0)) < 0.15, (order, deficits)


def test_red_cell_has_its_known_measures():
    m = measures(*red_cell(2, 3))
    # Values of the analytic profile; the mesh is off by O(h⁴), 5e-5 for the area at this level.
    np.testing.assert_allclose(m["area"], 33.25708682, rtol=1e-4)
    np.testing.assert_allclose(m["volume"], 11.72861257, rtol=1e-4)
    np.testing.assert_allclose(m["reduced_volume"], 0.650349, rtol=1e-4)


# 2. Symmetries, to rounding error.
def test_measures_move_and_scale_with_the_surface():
    mesh, x = icosphere(1, 2)
    x = x * jnp.array([[1.0, 1.2, 1.5]]) + 0.02 * jr.normal(jr.key(0), x.shape)
    R, b = random_rotation(jr.key(1)), jnp.array([[1.0, -2.0, 0.5]])
    here, moved, scaled = (measures(mesh, y) for y in (x, x @ R.T + b, 3.0 * x))
    for name, power in (("area", 2), ("volume", 3), ("reduced_volume", 0), ("area_radius", 1)):
        np.testing.assert_allclose(moved[name], here[name], rtol=1e-12)
        np.testing.assert_allclose(scaled[name], 3.0**power * here[name], rtol=1e-12)
    np.testing.assert_allclose(moved["centroid"], R @ here["centroid"] + b[0], atol=1e-13)
    np.testing.assert_allclose(scaled["centroid"], 3 * here["centroid"], atol=1e-13)
    assert here["reduced_volume"] < 1


# 3. Derivatives.
def test_derivatives_of_measures():
    """Of the reduced volume, which is made of the area and the volume."""
    mesh, x = icosphere(1, 2)
    f = jax.jit(lambda x: reduced_volume(mesh, x * jnp.array([[1.0, 1.0, 2.0]])))
    phi, steps = jr.normal(jr.key(2), x.shape), (1e-2, 5e-3, 2.5e-3)
    order = observed_order(steps, taylor_remainders(f, x, phi, steps))
    assert abs(order - 2.0) < 0.1, order
    _, forward = jax.jvp(f, (x,), (phi,))
    np.testing.assert_allclose(forward, jnp.vdot(jax.grad(f)(x), phi), rtol=1e-12)


# 4. The theory behind the derivatives: d|Γ|(φ) = ∫H ν·φ and dVol(φ) = ∫ν·φ.
def test_first_variations_are_curvature_and_normal():
    mesh, x = icosphere(2, 2)
    phi = x * (1 + 0.3 * x[:, 2:] ** 2)  # on the unit sphere: V = 1 + 0.3 z², ∫V = 4π·1.1

    @jax.jit
    def slopes(x, phi):
        return jax.jvp(lambda x: (area(mesh, x), volume(mesh, x)), (x,), (phi,))[1]

    # O(h⁴), 4e-4 at this level
    np.testing.assert_allclose(slopes(x, phi), 4 * np.pi * 1.1 * np.array([2.0, 1.0]), rtol=1e-3)

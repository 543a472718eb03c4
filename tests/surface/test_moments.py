"""Curvature moments, centre and inertia: exact bodies, symmetries, other meshes, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.mesh import SurfaceMesh, ellipsoid
from jaxwillmore.surface import (
    area,
    body_centroid,
    curvature_moments,
    inertia_tensor,
    principal_moments,
)
from jaxwillmore.verify import rough_sphere, triaxial_ellipsoid

from ..helpers import observed_order, random_rotation, taylor_remainders

AXES = np.array([1.0, 1.2, 1.5])
POWERS = (1, 2, 3, 4)


@eqx.filter_jit
def outputs(mesh, x):
    return {
        "centroid": body_centroid(mesh, x),
        "inertia": inertia_tensor(mesh, x),
        "principal": principal_moments(mesh, x),
        "moments": curvature_moments(mesh, x, POWERS),
    }


def test_a_tetrahedron_has_its_exact_inertia():
    """∫x² = 1/60 and ∫xy = 1/120 over the corner of a cube, moved to its centre (¼, ¼, ¼)."""
    x = jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    cells = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    mesh = SurfaceMesh(cells=jnp.asarray(cells), degree=1, n_nodes=4)
    here, away = outputs(mesh, x), outputs(mesh, x + 7.0)
    np.testing.assert_allclose(here["centroid"], 0.25, rtol=1e-13)
    S = np.full((3, 3), -1 / 480) + (1 / 160 + 1 / 480) * np.eye(3)
    exact = np.trace(S) * np.eye(3) - S
    np.testing.assert_allclose(here["inertia"], exact, rtol=1e-12)
    np.testing.assert_allclose(away["inertia"], exact, rtol=1e-11)


@pytest.fixture(scope="module")
def series():
    return [outputs(*ellipsoid(tuple(AXES), level, 2)) for level in (1, 2)]


def test_ellipsoid_has_its_inertia_with_order_four(series):
    """I_x = V/5 (b² + c²)."""
    V = 4 / 3 * np.pi * AXES.prod()
    exact = V / 5 * (np.sum(AXES**2) - AXES**2)
    errors = [np.max(np.abs(np.diag(m["inertia"]) - exact)) for m in series]
    assert abs(observed_order((2.0, 1.0), errors) - 4.0) < 0.15, errors
    for m in series:
        np.testing.assert_allclose(m["principal"], np.sort(np.diag(m["inertia"])), rtol=1e-12)
        np.testing.assert_allclose(m["centroid"], 0.0, atol=1e-14)


def test_curvature_moments_converge_to_those_of_the_exact_surface(series):
    """Against spectral quadrature of the level set; order 3 at least."""
    surface = triaxial_ellipsoid()
    p, w = surface.points()
    H = surface.level_set.mean_curvature(p)
    exact = np.array([float(jnp.sum(w * H**k)) for k in POWERS])
    errors = np.array([np.abs(np.array(m["moments"]) / exact - 1) for m in series])
    assert np.all(errors[1] < errors[0] / 8) and np.all(errors[1] < 4e-3), errors


def test_nothing_depends_on_where_the_nodes_are(series):
    """Another mesh of the same ellipsoid gives the same numbers up to the error of the meshes."""
    mesh, sphere = rough_sphere(2, 2)
    other = outputs(mesh, sphere * jnp.asarray(AXES)[None])
    for name, rtol in (("principal", 1e-3), ("moments", 5e-3)):
        np.testing.assert_allclose(other[name], series[1][name], rtol=rtol)


def test_symmetries():
    mesh, x = ellipsoid(tuple(AXES), 1, 2)
    x = x + 0.05 * jnp.sin(2 * x[:, ::-1])
    R, b = random_rotation(jr.key(0)), jnp.array([[1.0, -2.0, 0.5]])
    here, moved, scaled = (outputs(mesh, y) for y in (x, x @ R.T + b, 2.0 * x))
    np.testing.assert_allclose(moved["centroid"], R @ here["centroid"] + b[0], atol=1e-13)
    np.testing.assert_allclose(moved["inertia"], R @ here["inertia"] @ R.T, atol=1e-12)
    np.testing.assert_allclose(moved["principal"], here["principal"], rtol=1e-12)
    np.testing.assert_allclose(moved["moments"], here["moments"], rtol=1e-11)
    np.testing.assert_allclose(scaled["inertia"], 32 * here["inertia"], rtol=1e-12)
    powers = 2.0 ** (2 - np.array(POWERS))
    np.testing.assert_allclose(scaled["moments"], powers * here["moments"], rtol=1e-11)


@pytest.mark.slow
def test_derivatives():
    mesh, x = ellipsoid(tuple(AXES), 0, 2)
    phi, w = jr.normal(jr.key(1), x.shape), jnp.arange(1.0, 5.0)

    @jax.jit
    def f(x):
        moments = jnp.vdot(w, curvature_moments(mesh, x, POWERS))
        bodies = jnp.sum(principal_moments(mesh, x) * w[:3]) + jnp.sum(body_centroid(mesh, x))
        return jnp.stack([moments, bodies])

    _, forward = jax.jvp(f, (x,), (phi,))
    _, pull = jax.vjp(f, x)
    for k in range(2):
        row = jnp.zeros(2).at[k].set(1.0)
        np.testing.assert_allclose(forward[k], jnp.vdot(pull(row)[0], phi), rtol=1e-10)
        steps = (4e-4, 2e-4, 1e-4)
        remainders = taylor_remainders(lambda x, k=k: f(x)[k], x, phi, steps)
        assert abs(observed_order(steps, remainders) - 2.0) < 0.05, remainders


def test_the_zeroth_moment_is_the_area_and_negative_powers_are_refused():
    mesh, x = ellipsoid(tuple(AXES), 0, 2)
    np.testing.assert_allclose(curvature_moments(mesh, x, (0,)), [area(mesh, x)], rtol=1e-13)
    with pytest.raises(ValueError, match="non-negative integers"):
        curvature_moments(mesh, x, (-1,))

"""Dziuk's and BGN's schemes: exact laws, invariants, derivatives. All on 42 vertices, 20 steps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.schemes import (
    BGNMeanCurvature,
    BGNWillmore,
    DziukMeanCurvature,
    DziukWillmore,
    march,
)

from ..helpers import with_nan

MEAN_CURVATURE = [DziukMeanCurvature(), BGNMeanCurvature()]
WILLMORE = [DziukWillmore(), BGNWillmore()]
N = 20


def name(scheme):
    return type(scheme).__name__


def willmore(mesh, run):
    return np.array(jax.jit(jax.vmap(lambda x: jw.energies.Willmore()(mesh, x)))(run.x))


def mean_radius(x):
    return float(jnp.mean(jnp.linalg.norm(x, axis=1)))


def marched_to(scheme, mesh, x, t1, n):
    """Nodes at `t1` after `n` steps, by marches of the one length that is compiled."""
    fields = None
    for _ in range(n // N):
        run = march(scheme, mesh, x, tau=t1 / n, n_steps=N, fields=fields)
        x, fields = run.x[-1], {k: v[-1] for k, v in run.fields.items()}
    return x


@pytest.fixture(scope="module")
def sphere():
    return jw.mesh.icosphere(1, degree=1)


@pytest.fixture(scope="module")
def dumbbell():
    return jw.mesh.dumbbell(1, degree=1)


@pytest.mark.parametrize("scheme", MEAN_CURVATURE, ids=name)
def test_a_sphere_shrinks_by_its_law_at_first_order_in_the_step(scheme, sphere):
    r"""$R^2 = 1 - 4t$; the limit of short steps is off by the mesh, $O(h^2)$."""
    mesh, x = sphere
    R = [mean_radius(marched_to(scheme, mesh, x, 0.1, n)) for n in (N, 2 * N, 4 * N)]
    order = np.log2((R[1] - R[0]) / (R[2] - R[1]))
    assert abs(order - 1) < 0.15, order
    limit = 2 * R[2] - R[1]
    assert abs(limit - np.sqrt(0.6)) < 0.04  # h = 0.6; a quarter of it on the next mesh


@pytest.mark.slow
@pytest.mark.parametrize("scheme", MEAN_CURVATURE, ids=name)
def test_the_radius_is_of_second_order_in_the_mesh(scheme):
    errors = []
    for level in (1, 2, 3):
        mesh, x = jw.mesh.icosphere(level, degree=1)
        R = [mean_radius(marched_to(scheme, mesh, x, 0.1, n)) for n in (N, 2 * N)]
        errors.append(abs(2 * R[1] - R[0] - np.sqrt(0.6)))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.2)


@pytest.mark.parametrize("scheme", WILLMORE, ids=name)
def test_a_sphere_is_stationary_for_willmore_flow(scheme, sphere):
    mesh, x = sphere
    x1 = march(scheme, mesh, x, tau=1e-3, n_steps=N).x[-1]
    radii = jnp.linalg.norm(x1, axis=1)
    assert abs(mean_radius(x1) - 1) < 1e-3
    assert float(jnp.ptp(radii)) < 0.02  # the twelve vertices of valence 5 settle at O(h²)


@pytest.mark.parametrize("scheme", WILLMORE, ids=name)
def test_the_energy_of_an_ellipsoid_falls_towards_that_of_a_sphere(scheme):
    mesh, x = jw.mesh.ellipsoid((1.0, 1.0, 2.0), 1, degree=1)
    energies = willmore(mesh, march(scheme, mesh, x, tau=2e-3, n_steps=N))
    assert np.all(np.diff(energies) < 0)
    assert energies[-1] < energies[0] - 0.4 * (energies[0] - 8 * np.pi)


@pytest.mark.parametrize(
    "dziuk, bgn", [MEAN_CURVATURE, WILLMORE], ids=["mean curvature", "willmore"]
)
def test_bgn_keeps_the_angles_of_a_dumbbell_where_dziuk_does_not(dziuk, bgn, dumbbell):
    mesh, x = dumbbell
    tau = 4e-3 if dziuk in MEAN_CURVATURE else 2e-3
    before = jw.mesh.quality(mesh, x).min_angle
    of_dziuk, of_bgn = (
        jw.mesh.quality(mesh, march(scheme, mesh, x, tau=tau, n_steps=N).x[-1]).min_angle
        for scheme in (dziuk, bgn)
    )
    assert of_bgn > 1.3 * before
    assert of_bgn > 1.3 * of_dziuk


@pytest.mark.parametrize("scheme", MEAN_CURVATURE, ids=name)
def test_the_area_falls_whatever_the_step(scheme, dumbbell):
    mesh, x = dumbbell
    area = jax.jit(jax.vmap(lambda x: jw.surface.area(mesh, x)))
    for tau in (1e-3, 0.1):
        # The surface would vanish at t = 0.09: long steps leave a speck, and then nothing.
        areas = np.array(area(march(scheme, mesh, x, tau=tau, n_steps=N, throw=False).x))
        assert np.all(np.diff(areas[np.isfinite(areas)][:7]) < 0), tau


@pytest.mark.parametrize(
    "scheme, power", [(s, 2) for s in MEAN_CURVATURE] + [(s, 4) for s in WILLMORE]
)
def test_surfaces_of_another_size_do_the_same_in_their_own_time(scheme, power, dumbbell):
    mesh, x = dumbbell
    one = march(scheme, mesh, x, tau=1e-3, n_steps=N)
    big = march(scheme, mesh, 50 * x, tau=1e-3 * 50.0**power, n_steps=N)
    np.testing.assert_allclose(big.x[-1] / 50, one.x[-1], atol=1e-9)


def test_the_modulus_is_a_unit_of_time(dumbbell):
    mesh, x = dumbbell
    for kind in (DziukWillmore, BGNWillmore):
        soft = march(kind(0.5), mesh, x, tau=1e-3, n_steps=N).x[-1]
        stiff = march(kind(1.5), mesh, x, tau=1e-3 / 3, n_steps=N).x[-1]
        np.testing.assert_allclose(stiff, soft, atol=1e-9)


@pytest.mark.parametrize(
    "scheme",
    [
        BGNWillmore(),
        *(pytest.param(s, marks=pytest.mark.slow) for s in (*MEAN_CURVATURE, DziukWillmore())),
    ],
    ids=name,
)
def test_the_derivative_of_a_step_agrees_with_finite_differences(scheme):
    """By nodes, fields, step and modulus at once; forward and reverse mode are transposes."""
    mesh, x = jw.mesh.ellipsoid((1.0, 1.2, 1.5), 0, degree=1)
    grid = jw.schemes.grid(scheme, mesh)
    fields = scheme.initial_fields(mesh, x)
    w = jr.normal(jr.key(0), x.shape)

    @jax.jit
    def value(p):
        scheme, x, tau, fields = p
        new, fields = jw.schemes.step(scheme, grid, x, tau, fields)
        return jnp.sum(w * new) + sum(jnp.sum(jnp.sin(f)) for f in fields.values())

    at = (scheme, x, jnp.asarray(1e-2), fields)
    leaves, tree = jax.tree.flatten(at)
    keys = jr.split(jr.key(1), len(leaves))
    d = [jr.normal(k, a.shape) * jnp.max(jnp.abs(a)) for k, a in zip(keys, leaves, strict=True)]
    d = jax.tree.unflatten(tree, d)

    def along(h):
        return value(jax.tree.map(lambda a, b: a + h * b, at, d))

    h = 1e-4
    slope = (8 * (along(h) - along(-h)) - (along(2 * h) - along(-2 * h))) / (12 * h)
    _, forward = jax.jvp(value, (at,), (d,))
    gradient = jax.grad(value)(at)
    reverse = sum(jnp.sum(a * b) for a, b in zip(*map(jax.tree.leaves, (gradient, d)), strict=True))
    np.testing.assert_allclose(forward, slope, rtol=1e-7)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)


@with_nan
def test_a_broken_run_is_reported_with_its_time(dumbbell):
    mesh, x = dumbbell
    lost = {"Y": jnp.full_like(x, jnp.nan)}
    with pytest.raises(RuntimeError, match="broke down in step 1, after t = 0"):
        march(DziukWillmore(), mesh, x, tau=1e-3, n_steps=N, fields=lost)
    run = march(DziukWillmore(), mesh, x, tau=1e-3, n_steps=N, fields=lost, throw=False)
    np.testing.assert_array_equal(run.x[0], x)
    assert not np.any(np.isfinite(run.x[1:]))


def test_bad_arguments_are_named(dumbbell):
    mesh, x = dumbbell
    with pytest.raises(ValueError, match="`tau` must be positive and finite; got -1.0"):
        march(BGNMeanCurvature(), mesh, x, tau=-1.0, n_steps=1)
    with pytest.raises(ValueError, match="`n_steps` must be at least 1; got 0"):
        march(BGNMeanCurvature(), mesh, x, tau=1.0, n_steps=0)
    with pytest.raises(ValueError, match=r"`fields` must give \['H'\]; got \['Y'\]"):
        march(BGNMeanCurvature(), mesh, x, tau=1.0, n_steps=1, fields={"Y": x})
    with pytest.raises(ValueError, match="degree 1; got degree 2"):
        march(BGNMeanCurvature(), *jw.mesh.icosphere(0, degree=2), tau=1.0, n_steps=1)
    with pytest.raises(ValueError, match="`bending_modulus` must be positive"):
        BGNWillmore(0.0)
    assert eqx.tree_equal(DziukWillmore(), DziukWillmore(0.5))

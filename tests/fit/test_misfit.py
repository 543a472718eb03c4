"""Harmonics as the distance of star-shaped surfaces: exact values, derivatives, twins, refusals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.fit import MatchIterate, match_shapes, name_of
from jaxwillmore.fit._misfit import Harmonics, Points
from jaxwillmore.fit._targets import target

from ..helpers import random_rotation
from .test_match import ROTATION, SHIFT, SIZE, START, TRUTH, near, twin as twin

MESH, X = meshes.icosphere(1, degree=2)
MISFIT = Harmonics(4)
SEEN = MISFIT.observe(target(MESH, X))


@eqx.filter_jit
def rows(x):
    return MISFIT.rows(SEEN, MESH, X, x)


def mean_square(x):
    r, star_shaped = rows(x)
    assert bool(star_shaped)
    return float(r @ r) / MISFIT.mass([target(MESH, X)])


def test_mean_square_distance_of_two_spheres_is_exact():
    """Concentric: the difference of the radii everywhere. Apart by d: d cosθ + O(d²).

    The mesh is 7e-4 smaller than the sphere.
    """
    np.testing.assert_allclose(mean_square(1.1 * X), 0.1**2, rtol=2e-3)
    d = 1e-3
    shifted = X + d * jnp.array([[0.6, 0.0, 0.8]])
    np.testing.assert_allclose(mean_square(shifted), d**2 / 3, rtol=3e-3)
    assert mean_square(X) < 1e-30
    assert len(rows(X)[0]) == MISFIT.shared(SEEN) + MISFIT.of_model(MESH)


@pytest.mark.parametrize("both_ways", [False, True])
def test_both_ways_together_count_like_one(both_ways):
    """Points of two concentric spheres: the difference of the radii; the noise of N points."""
    misfit, seen = Points(both_ways), target(MESH, X)
    observed = misfit.observe(seen)
    r, _ = misfit.rows(observed, MESH, X, 1.1 * X)
    assert len(r) == misfit.shared(observed) + misfit.of_model(MESH)
    np.testing.assert_allclose(float(r @ r) / misfit.mass([seen]), 0.1**2, rtol=1e-2)
    assert misfit.count([seen]) == seen.count


def test_two_meshes_of_a_surface_agree():
    """The coefficients do not see the mesh, but for its error; the surfaces are 0.1 apart in r."""
    R = random_rotation(jr.key(1))
    stretch = jnp.array([[1.0, 1.1, 1.3]])
    one, other = X * stretch, (X @ R.T) * stretch
    assert float(jnp.linalg.norm(rows(one)[0] - rows(other)[0])) < 1e-3
    assert float(jnp.linalg.norm(rows(one)[0])) > 0.3


def test_derivative_is_that_of_difference_quotients():
    x = X * jnp.array([[1.0, 1.2, 0.8]])
    direction = jr.normal(jr.key(0), X.shape)
    _, slope = jax.jvp(lambda x: rows(x)[0], (x,), (direction,))
    h = 1e-5
    quotient = (rows(x + h * direction)[0] - rows(x - h * direction)[0]) / (2 * h)
    np.testing.assert_allclose(slope, quotient, atol=1e-7)


def bean():
    """A long ellipsoid bent about an axis beside it: its centre of volume is not inside."""
    mesh, x = meshes.ellipsoid((0.3, 0.3, 2.5), level=1, degree=2)
    angle, radius = x[:, 2], 1.0 + x[:, 0]
    return mesh, jnp.stack([radius * jnp.cos(angle), x[:, 1], radius * jnp.sin(angle)], axis=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distance": "harmonics"}, r"not star-shaped: from its centre \(.*near \(.*points"),
        ({"distance": "volumes"}, '"points" or "harmonics"'),
        ({"distance": "harmonics", "both_ways": True}, "both_ways"),
        ({"distance": "harmonics", "max_degree": 0}, "from 2 to 30"),
    ],
)
def test_what_harmonics_cannot_say_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        match_shapes([bean()], **options)


def test_a_model_that_is_not_star_shaped_is_told_from_one_that_is():
    mesh, x = bean()
    seen = MISFIT.observe(target(*meshes.ellipsoid((0.3, 0.3, 2.5), level=1, degree=2)))
    assert not bool(MISFIT.rows(seen, mesh, x, x)[1])


@pytest.mark.slow
def test_a_twin_is_recovered_by_harmonics(twin):
    mesh, x, _ = twin
    begin = near((np.asarray(ROTATION), SHIFT, SIZE))
    # The disc is thin: from 0.1 beside its middle, where other fits begin, it is not star-shaped.
    (pose,) = begin.poses
    begin = MatchIterate(begin.parameters, (pose | {"origin": (SHIFT + 0.02).tolist()},))
    fit = match_shapes(
        [(mesh, x)],
        resume=begin,
        kind="oblate",
        level=1,
        distance="harmonics",
        new_references=False,
        throw=False,
    )
    assert fit.succeeded, name_of(fit.result)
    assert START["reduced_volume"] != TRUTH["reduced_volume"]
    for name, value in TRUTH.items():
        np.testing.assert_allclose(fit.shapes[0].parameters[name], value, rtol=1e-6)
    assert fit.shapes[0].distances["largest"] < 1e-6 * SIZE

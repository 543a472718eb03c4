"""Shape matching: twins, intervals, null directions, likelihood, named ends, refusals."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore import equilibria, mesh as meshes
from jaxwillmore.fit import MatchIterate, log_likelihood, match_shapes, name_of
from jaxwillmore.fit._pose import Pose
from jaxwillmore.fit._shape_residuals import Model, bare

from ..helpers import random_rotation
from .profiles import PROLATE, equilibrium_nodes

TRUTH = {"reduced_volume": 0.75, "scaled_spontaneous_curvature": -0.6}
# Both 50 % off: the volume by its distance from the sphere.
START = {"reduced_volume": 0.625, "scaled_spontaneous_curvature": -0.3}
SIZE, SHIFT, ROTATION = 2.5, np.array([1.0, -2.0, 0.5]), random_rotation(jr.key(4))


def first_equilibrium(p, kind="oblate"):
    """The spheroid that a fit starts with at parameters `p`, of R0 = 1."""
    v, H0 = p["reduced_volume"], p["scaled_spontaneous_curvature"]
    mesh, x = equilibria.spheroid(v, kind, level=1)
    held: dict[str, Any] = {"area": 4 * np.pi, "reduced_volume": v, "spontaneous_curvature": H0}
    return mesh, equilibria.equilibrium(mesh, x, stability=False, **held)


def moved_to(start, p):
    """The equilibrium at other parameters on the reference surface of `start`."""
    where = lambda q: (q.volume, q.spontaneous_curvature)
    values = p["reduced_volume"] * 4 * np.pi / 3, p["scaled_spontaneous_curvature"]
    return equilibria.resolve(
        start, eqx.tree_at(where, start.parameters, tuple(map(jnp.asarray, values)))
    )


@pytest.fixture(scope="module")
def twin():
    """An oblate made on the reference surface that the fit starts with, turned and scaled."""
    mesh, start = first_equilibrium(START)
    made = moved_to(start, TRUTH)
    return mesh, SIZE * made.x @ ROTATION.T + jnp.asarray(SHIFT)[None], made


def near(pose_of_truth):
    """Half way off in the parameters, and a little in place, turn (0.05) and size (10 %)."""
    R, origin, size = pose_of_truth
    g = 0.025
    turn = np.array([[1 - g**2, -2 * g, 0.0], [2 * g, 1 - g**2, 0.0], [0.0, 0.0, 1 + g**2]])
    pose = {
        "axes": (R @ turn / (1 + g**2)).tolist(),
        "origin": (np.asarray(origin) + 0.1).tolist(),
        "size": 0.9 * size,
    }
    return MatchIterate((START | {"scaled_pressure": 0.0},), (pose,))


@pytest.fixture(scope="module")
def fitted(twin):
    """The mesh leaves its mark on an axisymmetric shape: only near the right turn is the twin."""
    mesh, x, _ = twin
    rows = []
    fit = match_shapes(
        [(mesh, x)],
        resume=near((np.asarray(ROTATION), SHIFT, SIZE)),
        kind="oblate",
        level=1,
        new_references=False,
        throw=False,
        observer=lambda row, iterate: rows.append((row, iterate)),
    )
    return fit, rows


@pytest.mark.slow
def test_a_twin_is_recovered_from_half_way_off(fitted, twin):
    fit, _ = fitted
    assert fit.succeeded, name_of(fit.result)
    shape, made = fit.shapes[0], twin[2]
    for name, value in TRUTH.items():
        np.testing.assert_allclose(shape.parameters[name], value, rtol=1e-6)
    # Tension and pressure are the multipliers of the shape, in units of κ = 1 and R0 = 1.
    np.testing.assert_allclose(shape.parameters["scaled_tension"], made.tension, rtol=1e-6)
    np.testing.assert_allclose(shape.parameters["scaled_pressure"], made.pressure, rtol=1e-6)
    np.testing.assert_allclose(shape.parameters["radius"], SIZE, rtol=1e-6)
    assert shape.distances["largest"] < 1e-6 * SIZE


@pytest.mark.slow
def test_a_model_goes_a_long_way_in_parts():
    """Where Newton's method alone does not arrive; it is the shape that one finds there."""
    here = {"reduced_volume": 0.7, "scaled_spontaneous_curvature": 0.6}
    there = {"reduced_volume": 0.8, "scaled_spontaneous_curvature": 1.2}
    _, start = first_equilibrium(here, "prolate")
    assert not bool(moved_to(start, there).converged)
    model = Model(bare(start), Pose(jnp.eye(3), jnp.zeros(3), jnp.ones(())))
    solved = eqx.filter_jit(lambda model, p: model.solved(p))
    found, exists = solved(
        model,
        {name: jnp.asarray(v) for name, v in there.items()} | {"scaled_pressure": jnp.zeros(())},
    )
    assert bool(exists) and bool(found.converged)
    np.testing.assert_allclose(
        found.energy, first_equilibrium(there, "prolate")[1].energy, rtol=0.02
    )
    np.testing.assert_allclose(found.volume, there["reduced_volume"] * 4 * np.pi / 3, rtol=1e-9)


@pytest.mark.slow
def test_the_words_say_that_kappa_is_not_in_a_shape(fitted):
    fit, _ = fitted
    assert fit.in_words()[1].startswith("κ is not identifiable")
    assert all(fit.identification.identifiable.values())


@pytest.mark.slow
def test_every_step_is_seen_and_the_last_is_where_it_ended(fitted):
    fit, rows = fitted
    assert len(rows) == len(fit.history) > 3
    assert rows[-1][0]["rms"] < rows[0][0]["rms"]
    again = MatchIterate.from_json(fit.iterate.to_json())
    assert again == fit.iterate
    assert rows[-1][1].parameters == fit.iterate.parameters


@pytest.mark.slow
def test_likelihood_is_greatest_at_the_truth_and_has_the_right_derivatives(fitted, twin):
    """Reverse, forward and difference quotients agree on points that lie off the surface.

    The second derivative is the one of a curved surface: closest points move with it.
    """
    fit, _ = fitted
    rng = np.random.default_rng(0)
    points = jnp.asarray(np.asarray(twin[1]) + 0.02 * rng.normal(size=(len(twin[1]), 3)))
    direction = jnp.asarray(rng.normal(size=len(fit.u)))

    @eqx.filter_jit
    def of(model, u):
        value = lambda u: log_likelihood(model, u, (points,), jnp.asarray(0.02))
        slope, second = jax.jvp(jax.grad(value), (u,), (direction,))
        return *jax.jvp(value, (u,), (direction,)), slope, second

    value, forward, gradient, second = of(fit.residuals, fit.u)
    np.testing.assert_allclose(forward, jnp.vdot(gradient, direction), rtol=1e-9)
    h = 1e-5
    plus, minus = (of(fit.residuals, fit.u + s * h * direction) for s in (1, -1))
    np.testing.assert_allclose((plus[0] - minus[0]) / (2 * h), forward, rtol=1e-4)
    difference = (plus[2] - minus[2]) / (2 * h)
    np.testing.assert_allclose(second, difference, rtol=1e-4, atol=1e-5 * jnp.max(jnp.abs(second)))
    far = of(fit.residuals, fit.u.at[0].add(-0.2))[0]
    assert float(far) < float(value) - 10


@pytest.mark.slow
def test_a_bound_in_the_way_is_no_success(twin):
    mesh, x, _ = twin
    fit = match_shapes(
        [(mesh, x)],
        start=START,
        kind="oblate",
        level=1,
        bounds={"reduced_volume": (0.5, 0.7)},
        new_references=False,
        throw=False,
    )
    assert not fit.succeeded
    assert fit.on_bound == ("reduced_volume",) or name_of(fit.result) == "stalled"


@pytest.mark.slow
def test_a_fit_that_runs_out_of_steps_says_so_and_resumes(twin):
    mesh, x, _ = twin
    options = {"kind": "oblate", "level": 1, "throw": False}
    short = match_shapes([(mesh, x)], start=START, max_steps=2, **options)
    assert name_of(short.result) == "step_limit" and not short.succeeded
    more = match_shapes([(mesh, x)], resume=short.iterate, max_steps=1, **options)
    for name in TRUTH:
        assert more.history[0][name] == pytest.approx(short.history[-1][name], rel=1e-12)
    with pytest.raises(RuntimeError, match="step_limit"):
        match_shapes([(mesh, x)], resume=short.iterate, max_steps=1, kind="oblate", level=1)


@pytest.mark.slow
def test_shapes_share_one_spontaneous_curvature_and_keep_their_volumes():
    """H0 is one number in 1/length: H0·R0 of a shape twice as large is twice as large."""
    volumes, sizes, curvature = (0.75, 0.7), (1.0, 2.0), -0.9 / 1.5
    targets, poses, starts = [], [], []
    for v, size in zip(volumes, sizes, strict=True):
        begin = {"reduced_volume": v - 0.03, "scaled_spontaneous_curvature": 1.2 * curvature * size}
        mesh, start = first_equilibrium(begin)
        made = moved_to(
            start, {"reduced_volume": v, "scaled_spontaneous_curvature": curvature * size}
        )
        targets.append((mesh, size * made.x))
        poses.append({"axes": np.eye(3).tolist(), "origin": [0.0, 0.0, 0.0], "size": size})
        # The shared unknown is in units of the mean radius, 1.5.
        shared = {"scaled_spontaneous_curvature": 1.2 * curvature * 1.5, "scaled_pressure": 0.0}
        starts.append(begin | shared)
    fit = match_shapes(
        targets,
        resume=MatchIterate(tuple(starts), tuple(poses)),
        kind="oblate",
        level=1,
        new_references=False,
        throw=False,
    )
    assert fit.succeeded, name_of(fit.result)
    labels = ("reduced_volume[0]", "reduced_volume[1]", "scaled_spontaneous_curvature")
    assert set(fit.identification.names) == set(labels)
    for shape, v, size in zip(fit.shapes, volumes, sizes, strict=True):
        np.testing.assert_allclose(shape.parameters["reduced_volume"], v, rtol=1e-3)
        found = shape.parameters["scaled_spontaneous_curvature"]
        np.testing.assert_allclose(found, curvature * size, rtol=2e-2)


@pytest.mark.slow
def test_pressure_may_be_free_in_place_of_the_volume():
    """A prolate of the shape equations: its pressure is found and its volume follows."""
    H0, _, pressure = PROLATE[:3]
    mesh, x = equilibrium_nodes(*PROLATE, level=1)
    fit = match_shapes(
        [(mesh, x)],
        free=("scaled_pressure",),
        start={"scaled_pressure": 1.1 * pressure, "scaled_spontaneous_curvature": H0},
        level=1,
        throw=False,
    )
    assert fit.succeeded, name_of(fit.result)
    # 162 nodes; the volume of the exact shape is 0.8001.
    np.testing.assert_allclose(fit.shapes[0].parameters["scaled_pressure"], pressure, rtol=0.03)
    np.testing.assert_allclose(fit.shapes[0].parameters["reduced_volume"], 0.8001, atol=5e-3)


ROUND = meshes.icosphere(0, degree=2)


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ([], "empty"),
        ([(ROUND[0], -ROUND[1])], "inside out"),
        ([(ROUND[0], np.nan * np.asarray(ROUND[1]))], "not finite"),
        ([(ROUND[0], jnp.zeros((42, 3)))], "flat or a point"),
        ([meshes.torus(1.0, 0.4, level=0)], "genus 1"),
        ([(np.array([[0, 1, 2], [0, 2, 3]]), np.eye(4, 3) + 1.0)], "(?i)edge|open|closed"),
    ],
)
def test_wrong_targets_are_refused(targets, message):
    with pytest.raises(ValueError, match=message):
        match_shapes(targets)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"free": ("bending_modulus",)}, "`free` has 'bending_modulus'"),
        ({"free": ()}, "`free` is empty"),
        ({"free": ("reduced_volume", "scaled_pressure")}, "not both"),
        ({"free": ("scaled_pressure",)}, "either free and has a value"),
        ({"start": {"scaled_pressure": -3.0}}, "either free and has a value"),
        ({"start": {"reduced_volume": 1.2}}, "between 0.25 and 0.997"),
        ({"start": {"tension": 1.2}}, "`start` has 'tension'"),
        ({"bounds": {"reduced_volume": (0.9, 0.5)}}, "in order"),
        ({"tolerance": 0.0}, "must be positive"),
        ({"kind": "bowl"}, "`kind` must be one of prolate, oblate, stomatocyte, several"),
    ],
)
def test_wrong_questions_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        match_shapes([(ROUND[0], ROUND[1] * jnp.array([[1.0, 1.0, 1.4]]))], **options)

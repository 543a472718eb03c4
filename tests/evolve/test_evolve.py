"""Runs: exact laws, symmetries, promises about steps and states, and every way to stop."""

import functools as ft
import io
import os
import signal

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.evolve import Stepper, TextProgressMeter, evolve, name_of, replay
from jaxwillmore.evolve._evolve import _energy_tolerance
from jaxwillmore.flows import Forcing, Loads, MeanCurvatureFlow, System, WillmoreFlow, as_system
from jaxwillmore.mesh import ellipsoid, icosphere, red_cell
from jaxwillmore.surface import Ellipsoid, area, volume

from ..helpers import random_rotation

# One mesh of 162 nodes and one scheme throughout, so that the step is compiled once.
AXES = (1.0, 1.2, 1.5)
MESH, SPHERE = icosphere(1, 2)
_, X = ellipsoid(AXES, 1, 2)
EXACT = {"H": Ellipsoid(AXES).mean_curvature(X), "nu": Ellipsoid(AXES).normal(X)}
ROUND = {"H": jnp.full(MESH.n_nodes, 2.0), "nu": SPHERE}
FLOW = as_system(WillmoreFlow())

run = ft.partial(evolve, FLOW, MESH)
slow = pytest.mark.slow


@pytest.fixture(scope="module")
def solution():
    """An ellipsoid on its way to the sphere."""
    seen, saved = [], []
    solution = run(
        X,
        t1=0.05,
        initial=EXACT,
        saveat=0.01,
        observer=lambda record, state: seen.append((record, state)),
        on_save=saved.append,
    )
    return solution, seen, saved


# 1. Promises.


def test_a_run_lowers_the_energy_and_reaches_the_end(solution):
    solution, _, _ = solution
    assert name_of(solution.result) == "reached_t1" and solution.succeeded
    assert solution.times[-1] == solution.state.t == 0.05
    energies = [record["energy"] for record in solution.records]
    assert np.all(np.diff(energies) < 1e-5 * energies[0])
    assert energies[-1] < energies[0] - 0.5
    np.testing.assert_allclose(energies, [r["willmore"] for r in solution.records], rtol=1e-12)


def test_the_books_agree(solution):
    solution, seen, _ = solution
    assert len(solution.records) == len(solution.times) - 1 == solution.stats["steps"]
    assert [r["step"] for r in solution.records] == list(range(1, len(solution.times)))
    np.testing.assert_array_equal([r["t"] for r in solution.records], solution.times[1:])
    np.testing.assert_allclose(
        [r["dt"] for r in solution.records], np.diff(solution.times), rtol=1e-10
    )
    assert all(r["rejected_steps"] == 0 for r in solution.records)
    total = sum(r["newton_iterations"] for r in solution.records)
    assert total == solution.stats["newton_iterations"]
    assert [record for record, _ in seen] == list(solution.records)
    # What a table of a run needs, by these names.
    assert set(solution.records[0]) >= {
        "step", "t", "dt", "energy", "willmore", "willmore_of_field", "area", "volume",
        "reduced_volume", "min_angle", "max_angle", "normal_length_defect", "normal_distance",
        "newton_iterations", "krylov_iterations", "rejected_steps",
    }  # fmt: skip


def test_states_are_saved_where_asked(solution):
    solution, seen, saved = solution
    np.testing.assert_allclose([s.t for s in saved], [0.0, 0.01, 0.02, 0.03, 0.04, 0.05])
    assert [s.t for s in solution.saved] == [s.t for s in saved]
    # The initial state: as given, and no V and z.
    first = solution.saved[0]
    np.testing.assert_array_equal(first.x, X)
    np.testing.assert_array_equal(first.nu, EXACT["nu"])
    assert set(first.fields) == {"H", "nu"}
    # The last one is a step, not an interpolation.
    np.testing.assert_array_equal(solution.saved[-1].x, seen[-1][1].x)
    # Those between lie between: the energy of an interpolated surface is as low as its neighbours.
    for state in solution.saved[1:-1]:
        before = max((s for _, s in seen if s.t <= state.t), key=lambda s: s.t)
        after = min((s for _, s in seen if s.t >= state.t), key=lambda s: s.t)
        energy = [float(FLOW.energy(MESH, s.x)) for s in (before, state, after)]
        assert energy[2] - 1e-4 < energy[1] < energy[0] + 1e-4


@pytest.mark.slow
def test_a_replay_has_the_states_of_the_run(solution):
    """The run is solved to 1e-8 and the replay to 1e-11."""
    solution, seen, _ = solution
    stepper = Stepper(FLOW, MESH, newton_tolerance=1e-11)
    again = eqx.filter_jit(lambda t: replay(FLOW, MESH, X, t, initial=EXACT, stepper=stepper))
    times = jnp.asarray(solution.times)
    trajectory = again(times)
    assert bool(trajectory.converged) and trajectory.x.shape == (len(times), *X.shape)
    np.testing.assert_array_equal(trajectory.x[0], X)
    for k, (_, state) in enumerate(seen):
        np.testing.assert_allclose(trajectory.x[k + 1], state.x, atol=1e-7)
        for name, size in (("nu", 1.0), ("H", 1.0), ("V", 100.0)):
            found, expected = trajectory.fields[name][k], state.fields[name]
            np.testing.assert_allclose(found, expected, atol=1e-6 * size)
    # Steps that do not converge are reported, and nothing is raised.
    assert not bool(again(1e6 * times).converged)


def test_the_nodes_move_with_the_normal_velocity(solution):
    """(x₂ − x₁)/τ ≈ Vν between two late steps, to the first order in τ."""
    _, seen, _ = solution
    (_, a), (_, b) = seen[-2:]
    moved = (b.x - a.x) / (b.t - a.t)
    mean = 0.5 * (a.V[:, None] * a.nu + b.V[:, None] * b.nu)
    scale = float(jnp.max(jnp.abs(mean)))
    np.testing.assert_allclose(moved, mean, atol=0.05 * scale)


# 2. Exact laws.


def sphere_radius(t, R, b, H0):
    """Ṙ = bH₀(2 − H₀R)/R² by tiny steps of the classical Runge–Kutta method."""
    law = lambda R: b * H0 * (2 - H0 * R) / R**2
    h = t / 1000
    for _ in range(1000):
        k1 = law(R)
        k2 = law(R + 0.5 * h * k1)
        k3 = law(R + 0.5 * h * k2)
        k4 = law(R + h * k3)
        R += h * (k1 + 2 * k2 + 2 * k3 + k4) / 6
    return R


@pytest.mark.parametrize("b_b, H0, t1", [(0.5, 1.0, 0.2), (0.7, -0.6, 0.1)])
def test_a_sphere_with_spontaneous_curvature_follows_its_law(b_b, H0, t1):
    flow = WillmoreFlow(b_b, H0)
    solution = evolve(flow, MESH, SPHERE, t1=t1, initial=ROUND, rtol=1e-4)
    radii = np.linalg.norm(np.asarray(solution.state.x), axis=1)
    expected = sphere_radius(t1, 1.0, 2 * b_b, H0)
    assert abs(expected - 1) > 0.1  # it moves
    # The error of 162 nodes in the mean is 1e-3, at the worst node twice that.
    error = np.abs(radii - expected)
    assert np.sqrt(np.mean(error**2)) < 1.1e-3 and np.max(error) < 2.2e-3
    np.testing.assert_allclose(solution.state.H, 2 / expected, atol=1e-2)


def test_a_sphere_stays():
    solution = run(SPHERE, t1=1.0, initial=ROUND)
    radii = np.linalg.norm(np.asarray(solution.state.x), axis=1)
    np.testing.assert_allclose(radii, 1.0, atol=3e-3)  # it settles on the discrete sphere
    energies = [r["energy"] for r in solution.records]
    assert np.ptp(energies) < 2e-3 * energies[0]
    assert solution.stats["steps"] < 40  # nothing happens, so steps grow


def mean_length_of_normals(consistency, defect, steps=20, dt=2e-4):
    """Growth of the mean length of ν that starts as (1 + defect) ν, step by step."""
    lengths = []

    def watch(_, state):
        normal = state.x / jnp.linalg.norm(state.x, axis=1, keepdims=True)
        lengths.append(float(jnp.mean(jnp.sum(state.nu * normal, axis=1))) - 1)

    evolve(
        WillmoreFlow(consistency=consistency),
        MESH,
        SPHERE,
        t1=steps * dt,
        dt0=dt,
        rtol=None,
        energy_tolerance=None,
        initial=ROUND | {"nu": (1 + defect) * SPHERE},
        observer=watch,
    )
    return np.array(lengths)


@pytest.mark.parametrize("consistency, low, high", [(0.0, 7.9, 8.1), (2.5, -2.1, 0.05)])
def test_growth_of_a_normal_that_is_too_long(consistency, low, high):
    """On the unit sphere e' = (8 − α)e with α = 4c: +8 without the consistency terms.

    The difference of two runs, so that the noise of the mesh cancels.
    """
    dt = 2e-4
    e = mean_length_of_normals(consistency, 1e-4) - mean_length_of_normals(consistency, 0.0)
    rates = np.diff(np.log(e)) / dt
    assert np.all((low <= rates[5:]) & (rates[5:] <= high)), rates


def test_the_second_mode_of_a_sphere_decays_at_its_rate():
    """(l−1)l(l+1)(l+2) = 24 for l = 2, within the 3 % of 162 nodes."""
    harmonic = 1.5 * SPHERE[:, 2] ** 2 - 0.5
    amplitudes = []

    def watch(_, state):
        radii = jnp.linalg.norm(state.x, axis=1)
        amplitudes.append((state.t, float(jnp.vdot(radii - 1, harmonic))))

    def decay(amplitude):
        amplitudes.clear()
        x = SPHERE * (1 + amplitude * harmonic[:, None])
        run(x, t1=0.02, dt0=1e-3, rtol=None, energy_tolerance=None, observer=watch)
        return np.array(amplitudes).T

    (t, a), (_, b) = decay(1e-3), decay(-1e-3)
    rates = np.diff(np.log(a - b)) / np.diff(t)
    assert np.all(np.abs(rates[5:] + 24) < 0.04 * 24), rates


# 3. Symmetries.


def test_runs_turn_and_move_with_the_surface():
    R, b = random_rotation(jr.key(0)), jnp.array([[1.0, -2.0, 0.5]])
    one = run(X, t1=0.02)
    two = run(X @ R.T + b, t1=0.02)
    assert len(one.times) == len(two.times)
    np.testing.assert_allclose(two.state.x, one.state.x @ R.T + b, atol=1e-7)
    np.testing.assert_allclose(two.state.nu, one.state.nu @ R.T, atol=1e-7)


def test_runs_scale_with_the_surface_and_the_modulus():
    """λΓ(t/λ⁴) is a flow when Γ(t) is; the modulus is the unit of time."""
    one = run(X, t1=0.02)
    L, b_b = 1e-3, 2.0
    factor = L**4 / (2 * b_b)
    two = evolve(WillmoreFlow(b_b), MESH, L * X, t1=0.02 * factor)
    np.testing.assert_allclose(two.times, factor * np.array(one.times), rtol=1e-6)
    np.testing.assert_allclose(two.state.x / L, one.state.x, atol=1e-7)
    np.testing.assert_allclose(two.state.H * L, one.state.H, atol=1e-5)
    np.testing.assert_allclose(two.state.V * factor / L, one.state.V, atol=1e-4)
    assert two.records[-1]["energy"] == pytest.approx(2 * b_b * one.records[-1]["energy"], rel=1e-8)


def test_the_origin_of_time_does_not_matter():
    one, two = run(X, t1=0.02), run(X, t0=-7.0, t1=-6.98)
    np.testing.assert_allclose(np.array(two.times) + 7.0, one.times, atol=1e-9)
    np.testing.assert_allclose(two.state.x, one.state.x, atol=1e-6)


# 4. Steps.


def test_fixed_steps_are_kept():
    solution = run(X, t1=0.01, dt0=1e-3, rtol=None, initial=EXACT)
    steps = np.diff(solution.times)
    assert solution.times[-1] == 0.01 and solution.stats["rejected_steps"] == 0
    # One step of BDF1 has the error of the whole run of BDF2: all steps are equal.
    np.testing.assert_allclose(steps, 1e-3, rtol=1e-9)


def test_a_first_step_that_is_far_too_large_is_taken_back():
    solution = run(X, t1=100.0, dt0=50.0, max_steps=1, throw=False)
    assert solution.stats["rejected_steps"] >= 3
    assert solution.records[0]["rejected_steps"] == solution.stats["rejected_steps"]
    assert solution.records[0]["energy"] < FLOW.energy(MESH, X)
    np.testing.assert_allclose(volume(MESH, solution.state.x), volume(MESH, X), rtol=0.2)


@pytest.mark.slow
def test_the_error_follows_the_tolerance():
    """Ten times the tolerance, about ten times the error, against a much finer run."""
    fine = run(X, t1=0.02, initial=EXACT, rtol=1e-5)

    def error(rtol):
        coarse = run(X, t1=0.02, initial=EXACT, rtol=rtol)
        return float(jnp.max(jnp.abs(coarse.state.x - fine.state.x)))

    loose, tight = error(3e-3), error(3e-4)
    assert tight < 0.35 * loose and loose < 3e-3 * 3.0, (loose, tight)


def test_the_energy_guard_follows_from_the_laws():
    """Where a law does work the energy may rise: a run of `test_mean_curvature.py` shows it."""
    working = (
        MeanCurvatureFlow(lambda H: -1 / H),
        System(FLOW, Forcing(lambda t, p: p[0])),
        System(FLOW, Loads(volume=lambda t: 4.0 + t)),
    )
    for flow in working:
        assert _energy_tolerance(as_system(flow), 1e-5) == np.inf
    for flow in (MeanCurvatureFlow(), FLOW, System(FLOW, Loads(volume=4.0))):
        assert _energy_tolerance(as_system(flow), 1e-5) == 1e-5
        assert _energy_tolerance(as_system(flow), None) == np.inf


# 5. Every way to stop.


def stop(x=X, flow=FLOW, **keywords):
    keywords = {"t1": 0.05, "dt0": 1e-5, "initial": EXACT, "throw": False} | keywords
    return evolve(flow, MESH, x, **keywords)


STOPS = {
    "step_limit": {"max_steps": 2},
    "stationary": {"stationary_tolerance": 1e3},
    "not_finite": {"flow": WillmoreFlow(1e307), "dt0": 1e-300},
    "element_inverted": {"initial": {"nu": -EXACT["nu"]}},
    # Without the consistency terms a wrong H stays wrong and drives the surface away.
    "energy_rising": {
        "flow": WillmoreFlow(consistency=0.0),
        "initial": EXACT | {"H": -EXACT["H"]},
        "energy_tolerance": 1e-13,
    },
    "step_too_small": {"rtol": 1e-15},
    "resolution_lost": {"initial": EXACT | {"nu": 0.4 * EXACT["nu"]}},
}


@pytest.mark.parametrize("name", STOPS)
def test_a_run_says_why_it_stopped(name):
    solution = stop(**STOPS[name])
    assert name_of(solution.result) == name
    assert solution.succeeded == (name == "stationary")
    # The last good state is there, whole, and it is the one that the books end with.
    assert bool(jnp.all(jnp.isfinite(solution.state.x)))
    assert solution.state.t == solution.times[-1] < 0.05
    assert len(solution.records) == len(solution.times) - 1
    if name in ("step_limit", "stationary"):
        assert len(solution.records) == (2 if name == "step_limit" else 1)
    else:
        assert len(solution.records) == 0 and solution.stats["rejected_steps"] >= 10
        np.testing.assert_array_equal(solution.state.x, X)


@pytest.mark.parametrize("name", ["step_limit", "element_inverted"])
def test_a_failed_run_raises_with_its_reason(name):
    with pytest.raises(RuntimeError, match=rf"stopped at t = .* of 0.05 \({name}\): .*\."):
        stop(**STOPS[name], throw=True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_the_run_after_the_step(number):
    handler = signal.getsignal(number)

    def interrupt(record, _):
        if record["step"] == 2:
            os.kill(os.getpid(), number)

    solution = stop(observer=interrupt)
    assert name_of(solution.result) == "interrupted" and not solution.succeeded
    assert len(solution.records) == 2
    assert signal.getsignal(number) is handler


def test_a_progress_meter_shows_the_steps_beside_the_observer():
    out, seen = io.StringIO(), []
    meter = TextProgressMeter(out, interval=0.0)
    stop(max_steps=2, progress_meter=meter, observer=lambda record, _: seen.append(record))
    lines = out.getvalue().splitlines()
    assert len(lines) == 3 and len(seen) == 2
    assert lines[0].startswith("preparing") and lines[2].startswith("step     2  t 3e-05 of 0.05")


def test_an_observer_that_fails_is_not_silenced():
    def fail(record, _):
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        stop(observer=fail)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# 6. Long runs.


@pytest.mark.slow
def test_a_red_cell_becomes_a_sphere():
    """162 nodes to t = 5: the energy of the nodes, their area, and hardly a rejected step."""
    mesh, x = red_cell(1, 2)
    solution = evolve(FLOW, mesh, x, t1=5.0)
    energies = np.array([r["energy"] for r in solution.records])
    assert abs(energies[-1] / (8 * np.pi) - 1) < 2e-3
    assert solution.stats["rejected_steps"] <= 3
    assert np.all(np.diff(energies) <= 1e-5 * energies[:-1])
    areas = np.array([[r["t"], r["area"]] for r in solution.records]).T
    late = areas[1][areas[0] >= 0.8]
    assert np.ptp(late) < 5e-3 * late[0]
    assert solution.records[-1]["reduced_volume"] > 0.998
    assert solution.records[-1]["normal_length_defect"] < 0.02
    np.testing.assert_allclose(area(mesh, solution.state.x), late[-1], rtol=1e-12)


@pytest.mark.slow
def test_a_stationary_surface_ends_the_run():
    mesh, x = red_cell(1, 2)
    solution = evolve(FLOW, mesh, x, t1=500.0, stationary_tolerance=1e-3)
    assert name_of(solution.result) == "stationary" and solution.state.t < 500.0
    assert solution.records[-1]["stationarity"] <= 1e-3 < solution.records[-2]["stationarity"]


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["implicit", "linearly-implicit"])
def test_both_schemes_have_second_order_and_one_limit(scheme):
    """With BDF2 the difference from a fine implicit run falls by four when the step is halved.

    From fields that have come to rest on their surface: while they do so, at the start of every
    run, the linearly implicit scheme has order 1.5.
    """
    start = run(X, t1=0.02, rtol=1e-4, initial=EXACT).state
    fields = {name: start.fields[name] for name in ("H", "nu")}
    fixed = {"t1": 0.01, "rtol": None, "initial": fields, "newton_tolerance": 1e-10}
    fine = run(start.x, dt0=6.25e-5, **fixed).state.x
    errors = [
        float(jnp.max(jnp.abs(run(start.x, dt0=dt, scheme=scheme, **fixed).state.x - fine)))
        for dt in (5e-4, 2.5e-4)
    ]
    assert np.log2(errors[0] / errors[1]) > 1.9, errors
    assert errors[1] < 2e-6


@pytest.mark.parametrize(
    "method", ["dense", pytest.param("direct", marks=slow), pytest.param("pardiso", marks=slow)]
)
def test_the_linear_solver_does_not_change_the_run(method):
    if method == "pardiso":
        pytest.importorskip("pypardiso")
    one, two = run(X, t1=0.01), run(X, t1=0.01, linear_solver=method)
    np.testing.assert_allclose(two.state.x, one.state.x, atol=1e-7)


@pytest.mark.slow
def test_linear_and_cubic_surfaces_run():
    for degree, level in ((1, 2), (3, 0)):
        mesh, x = ellipsoid(AXES, level, degree)
        solution = evolve(FLOW, mesh, x, t1=0.5)
        # Flat triangles on a sphere have a reduced volume below 1 of their own.
        _, sphere = icosphere(level, degree)
        ideal = 6 * np.sqrt(np.pi) * volume(mesh, sphere) / area(mesh, sphere) ** 1.5
        assert abs(solution.records[-1]["reduced_volume"] - ideal) < 2e-3

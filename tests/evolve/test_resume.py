"""A run that goes on is the run that did not stop, to the last bit."""

import dataclasses
import functools as ft
import math
import os
import signal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.evolve import Checkpoints, evolve, name_of, parts_of, solution_of
from jaxwillmore.evolve._checkpoints import Pace
from jaxwillmore.flows import Forcing, Loads, MinimalDeformation, System, WillmoreFlow
from jaxwillmore.mesh import ellipsoid, icosphere
from jaxwillmore.surface import area, volume

MESH, X = ellipsoid((1.0, 1.0, 1.3), 1, 1)
A, V = float(area(MESH, X)), float(volume(MESH, X))
T1, HALF = 0.02, 5


def flow(modulus=1.0):
    """A new object in every call, as in a new process."""
    laws = WillmoreFlow(bending_modulus=modulus), Loads(area=A, volume=V), MinimalDeformation()
    return System(*laws)


# A step of 0.01 is rejected, which is when some of the runs below are stopped.
run = ft.partial(evolve, mesh=MESH, x0=X, t1=T1, saveat=0.004, throw=False)


def assert_same(one, two):
    """Equal to the last bit in everything but the time on the clock."""
    (words, arrays), (other_words, other_arrays) = parts_of(one), parts_of(two)
    for said in (words, other_words):
        said["stats"] = said["stats"] | {"wall_seconds": None}
    assert words == other_words and list(arrays) == list(other_arrays)
    for name, array in arrays.items():
        assert array.tobytes() == other_arrays[name].tobytes(), name


def as_read(solution):
    """As it comes from a file."""
    return solution_of(*parts_of(solution))


@pytest.fixture(scope="module")
def whole():
    """A run with an adaptive step that nothing stops, and what it handed out on the way."""
    handed = []
    solution = run(flow(), checkpoints=Checkpoints(handed.append, steps=3))
    return solution, handed


def test_a_run_stopped_half_way_goes_on_to_the_last_bit(whole):
    solution, _ = whole
    assert name_of(solution.result) == "reached_t1" and len(solution.records) > HALF + 2
    assert len(solution.saved) == 6
    half = run(flow(), observer=lambda record, _: record["step"] == HALF)
    assert name_of(half.result) == "stopped" and len(half.records) == HALF
    rows, states = [], []
    again = run(
        flow(),
        resume=as_read(half),
        observer=lambda record, _: rows.append(record),
        on_save=states.append,
    )
    assert_same(again, solution)
    assert again.records == solution.records and tuple(rows) == solution.records[HALF:]
    assert len(half.saved) + len(states) == len(solution.saved)
    assert abs(rows[-1]["area"] / A - 1) < 1e-12 and abs(rows[-1]["volume"] / V - 1) < 1e-12
    assert {"tension", "pressure"} <= set(rows[-1])


def test_the_jacobian_that_is_kept_decides_the_last_bits(whole):
    solution, handed = whole
    point = as_read(handed[1])
    assert point.continuation.kept is not None
    without = dataclasses.replace(point.continuation, kept=None)
    other = run(flow(), resume=dataclasses.replace(point, continuation=without))
    assert np.any(other.state.x != solution.state.x)
    np.testing.assert_allclose(other.state.x, solution.state.x, atol=1e-5)


def test_a_run_goes_on_from_everything_that_it_hands_out(whole):
    solution, handed = whole
    steps = [len(point.records) for point in handed]
    assert steps[:3] == [0, 3, 6]
    assert all(name_of(point.result) == "interrupted" for point in handed)
    for point in handed[:3:2]:
        assert_same(run(flow(), resume=as_read(point)), solution)


@pytest.mark.slow
def test_an_interrupt_between_two_attempts_at_a_step_is_no_loss():
    big = ft.partial(run, dt0=0.01, saveat=None)
    rejected = 0

    def at_the_first_rejection(*args):
        nonlocal rejected
        rejected += 1
        if rejected == 1:
            os.kill(os.getpid(), signal.SIGTERM)
        return original(*args)

    from jaxwillmore.evolve._loop import Loop

    solution = big(flow())
    assert solution.records[0]["rejected_steps"] > 0
    original = Loop._judge
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Loop, "_judge", at_the_first_rejection)
        stopped = big(flow())
    assert name_of(stopped.result) == "interrupted"
    assert stopped.continuation.rejections == 1 and not stopped.records
    assert_same(big(flow(), resume=as_read(stopped)), solution)


def test_a_run_at_its_end_stays_there_and_goes_further_when_asked(whole):
    solution, _ = whole
    assert_same(run(flow(), resume=as_read(solution)), solution)
    further = run(flow(), resume=as_read(solution), t1=1.5 * T1)
    assert further.state.t == 1.5 * T1 and further.times[: len(solution.times)] == solution.times
    np.testing.assert_allclose([s.t for s in further.saved][-2:], [0.024, 0.028], rtol=1e-12)
    assert further.records[-1]["energy"] < solution.records[-1]["energy"]
    with pytest.raises(ValueError, match="at t = 0.02, past t1 = 0.01"):
        run(flow(), resume=solution, t1=0.01)


@pytest.mark.slow
def test_a_step_limit_may_be_raised(whole):
    solution, _ = whole
    short = run(flow(), max_steps=4)
    assert name_of(short.result) == "step_limit"
    assert_same(run(flow(), resume=as_read(short)), solution)


def test_other_runs_are_refused_by_what_differs(whole):
    solution, handed = whole
    for arguments, words in (
        ({"rtol": 1e-2}, "`rtol` = 0.001; got 0.01"),
        ({"bdf_order": 3}, "`bdf_order` = 2; got 3"),
        ({"dt0": 1e-5}, "`dt0` = None; got 1e-05"),
        ({"x0": 1.01 * X}, "other nodes"),
        ({"mesh": icosphere(0, 2)[0], "x0": icosphere(0, 2)[1]}, "another mesh"),
    ):
        with pytest.raises(ValueError, match=words):
            run(flow(), resume=handed[1], **arguments)
    with pytest.raises(ValueError, match="flow with other parameters"):
        run(flow(2.0), resume=handed[1])
    with pytest.raises(ValueError, match="`fields` ="):
        run(WillmoreFlow(), resume=handed[1])
    # Another machine makes the same nodes up to rounding.
    nearly = run(flow(), x0=X * (1 + 1e-15), resume=handed[1])
    assert_same(nearly, solution)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"scheme": "linearly-implicit"},
        {"rtol": None, "dt0": 1e-3, "bdf_order": 3},
        {"linear_solver": "direct", "bdf_order": 1},
    ],
    ids=["linear", "fixed", "direct"],
)
def test_every_kind_of_step_goes_on(options):
    step = ft.partial(run, WillmoreFlow(), t1=0.01, saveat=0.003, **options)
    solution = step()
    half = len(solution.records) // 2
    assert half >= 2
    stopped = step(observer=lambda record, _: record["step"] == half)
    assert_same(step(resume=as_read(stopped)), solution)


def test_fixed_steps_divide_the_interval_that_they_began_with():
    fixed = ft.partial(run, WillmoreFlow(), rtol=None, dt0=1e-3, bdf_order=3, saveat=None)
    stopped = fixed(t1=0.01, observer=lambda record, _: record["step"] == 3)
    with pytest.raises(ValueError, match="`t1` = 0.01; got 0.02"):
        fixed(t1=0.02, resume=stopped)


def test_a_run_that_failed_fails_again():
    rough = {"H": jnp.full(MESH.n_nodes, math.sqrt(1e200)), "nu": X}
    failed = run(WillmoreFlow(), initial=rough)
    assert not failed.succeeded
    assert_same(run(WillmoreFlow(), resume=as_read(failed)), failed)


@pytest.mark.slow
def test_functions_in_a_flow_are_not_compared():
    forced = System(WillmoreFlow(), Forcing(lambda t, x: 0.0 * t))
    stopped = run(forced, t1=1e-5, observer=lambda *_: True)
    other = System(WillmoreFlow(), Forcing(lambda t, x: 0.0 * t))
    assert run(other, t1=1e-5, resume=stopped).succeeded


def test_checkpoints_are_paced_by_time_steps_and_cost(monkeypatch):
    clock, calls = [0.0], []
    monkeypatch.setattr("time.monotonic", lambda: clock[0])

    def write(solution):
        calls.append(clock[0])
        clock[0] += 3.0

    pace = Pace(Checkpoints(write, minutes=1.0))
    pace.now(lambda: None)  # pyright: ignore[reportArgumentType]
    for _ in range(400):
        clock[0] += 1.0
        pace.step(lambda: None)  # pyright: ignore[reportArgumentType]
    # Three seconds are 2 % of 150.
    assert calls == [0.0, 153.0, 306.0]
    calls.clear()
    pace = Pace(Checkpoints(write, steps=7))
    for _ in range(21):
        pace.step(lambda: None)  # pyright: ignore[reportArgumentType]
    assert len(calls) == 3
    for wrong in ({"minutes": 0.0}, {"minutes": math.nan}, {"steps": 0}):
        with pytest.raises(ValueError, match="must be"):
            Checkpoints(write, **wrong)


def test_a_solution_is_a_tree_of_arrays_and_numbers(whole):
    solution, _ = whole
    doubled = eqx.tree_at(lambda s: s.state.x, solution, replace_fn=lambda x: 2 * x)
    np.testing.assert_array_equal(doubled.state.x, 2 * solution.state.x)

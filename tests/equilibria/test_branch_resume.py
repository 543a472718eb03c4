"""A branch that goes on is the branch that did not stop, to the last bit."""

import copy
import dataclasses
import functools as ft
import json

import jax
import numpy as np
import pytest

from jaxwillmore import equilibria
from jaxwillmore.equilibria import _walk, branch_of, parts_of
from jaxwillmore.io._plain import plain

# The fixtures `disc` and `whole` are such branches.
follow = ft.partial(equilibria.branch, stop=0.72, max_step=0.01)


def assert_same(one, two):
    """Equal to the last bit."""
    (words, arrays), (other_words, other_arrays) = parts_of(one), parts_of(two)
    assert json.dumps(plain(words)) == json.dumps(plain(other_words))
    assert list(arrays) == list(other_arrays)
    for name, array in arrays.items():
        assert array.dtype == other_arrays[name].dtype, name
        assert array.tobytes() == other_arrays[name].tobytes(), name


def as_read(branch):
    """As it comes from a file."""
    words, arrays = parts_of(branch)
    return branch_of(json.loads(json.dumps(plain(words))), arrays)


def test_a_branch_comes_back_from_its_parts(whole):
    found, _ = whole
    again = as_read(found)
    assert_same(again, found)
    assert found.succeeded and len(found.events) == 1 and len(found.points) > 4
    for one, other in zip(found.points, again.points, strict=True):
        assert jax.tree.structure(one.parameters) == jax.tree.structure(other.parameters)
        # what is made again from the nodes included
        leaves = (jax.tree.leaves(shape) for shape in (one, other))
        assert all(np.array_equal(a, b) for a, b in zip(*leaves, strict=True))
        assert one.stats == other.stats
    assert again.table() == found.table()
    (event,), (same,) = found.events, again.events
    assert same.words == event.words and same.shape is again.points[same.point]
    assert dataclasses.replace(same, shape=event.shape, modes=event.modes) == event


def test_it_can_be_gone_on_with_like_the_one_that_was_written(whole):
    found, _ = whole
    again, rest = as_read(found), []
    for one in (found, again):
        further = equilibria.branch(one.points[-1], stop=0.73, max_step=0.01)
        crossing = equilibria.switch(one.events[0], stability=False)
        rest.append((further, crossing))
    assert_same(rest[0][0], rest[1][0])
    np.testing.assert_array_equal(rest[0][1].x, rest[1][1].x)


def test_a_branch_goes_on_from_everything_that_it_hands_out(disc, whole):
    found, handed = whole
    assert [equilibria.name_of(b.result) for b in handed] == ["interrupted"] * len(handed)
    # The start and every step; the event and the last point come with the step they belong to.
    assert len(handed) == len(found.points) - 2
    for so_far in handed[:2]:
        seen = []
        again = follow(
            disc, resume=as_read(so_far), observer=lambda row, _, seen=seen: seen.append(row)
        )
        assert_same(again, found)
        assert repr(tuple(seen)) == repr(found.rows[len(so_far.points) :])


def test_a_branch_stopped_at_any_point_goes_on_to_the_last_bit(disc, whole):
    """At an event, too, which is found again before the step it lies on is taken."""
    found, _ = whole
    # the last point before the event, the event, and the end
    for stop in (2, found.events[0].point + 1, len(found.points)):
        rows = []

        def observer(row, _, rows=rows, stop=stop):
            rows.append(row)
            return len(rows) == stop

        stopped = follow(disc, observer=observer)
        assert equilibria.name_of(stopped.result) == "stopped" and len(stopped.points) == stop
        again = follow(disc, resume=as_read(stopped), observer=observer)
        assert_same(again, found)
        # no point is seen twice
        assert repr(tuple(rows)) == repr(found.rows)


def test_more_points_may_be_asked_for(disc, whole):
    found, _ = whole
    short = follow(disc, max_points=1)
    assert equilibria.name_of(short.result) == "point_limit"
    assert_same(follow(disc, max_points=1, resume=as_read(short)), short)
    assert_same(follow(disc, resume=as_read(short)), found)


def test_a_branch_that_ended_comes_back_as_it_is(disc, whole):
    found, _ = whole
    assert follow(disc, resume=found) is found
    nowhere = equilibria.branch(disc, stop=float(disc.reduced_volume))
    assert nowhere.succeeded and nowhere.continuation is None
    assert_same(as_read(nowhere), nowhere)


def test_steps_that_were_halved_stay_so(disc, monkeypatch):
    """Steps aim at twice the displacement that is allowed here; one is stopped where it tries."""
    monkeypatch.setattr(_walk, "LARGEST_STEP", 0.5 * _walk.AIM)
    big, tried = ft.partial(equilibria.branch, disc, stop=0.9, max_points=1, stability=False), []
    found = big()

    def interrupted():
        tried.append(None)
        return len(tried) == 2

    with monkeypatch.context() as patch:
        patch.setattr(_walk, "interrupted", interrupted)
        stopped = big()
    assert equilibria.name_of(stopped.result) == "interrupted" and len(stopped.points) == 1
    assert stopped.continuation.length == 0.5 * big(max_points=0).continuation.length
    assert_same(big(resume=as_read(stopped)), found)


def test_other_branches_are_refused_by_what_differs(disc, whole):
    _, handed = whole
    go_on = ft.partial(follow, resume=handed[1])
    for arguments, words in (
        ({"stop": 0.75}, "`stop` = 0.72; got 0.75.*points.-1."),
        ({"step0": 0.01}, "`step0` = None; got 0.01"),
        ({"max_step": 0.02}, "`max_step` = 0.01; got 0.02"),
        ({"stability": False}, "`stability` = True; got False"),
        ({"parameter": "spontaneous_curvature"}, "`parameter` = 'reduced_volume'"),
    ):
        with pytest.raises(ValueError, match=words):
            go_on(disc, **arguments)
    with pytest.raises(ValueError, match="from another equilibrium"):
        go_on(handed[1].points[1])
    # Another machine finds the same start up to rounding.
    nearly = dataclasses.replace(disc, x=disc.x * (1 + 1e-15))
    assert_same(go_on(nearly), whole[0])


def broken(found, change):
    words, arrays = parts_of(found)
    words = json.loads(json.dumps(plain(words)))
    change(words, arrays)
    return words, arrays


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda w, a: a.update(x=a["x"][:, :-1]), r"'x' has shape \(5, 41, 3\).*any.*42, 3"),
        (lambda w, a: a.update(x=a["x"][:-1]), "5 points, and its array 'x' has 4"),
        (lambda w, a: a.update(unknowns=a["unknowns"][:, 1:]), "'unknowns' has shape"),
        (lambda w, a: a.update(numbers=a["numbers"][:, 1:]), "'numbers' has shape"),
        (lambda w, a: a.update(Y=a["Y"].astype("float32")), "float32"),
        (lambda w, a: a.update({"at.y": a["at.y"].T}), r"'at.y' has shape \(3, 42\)"),
        (lambda w, a: a.update({"at.g": np.full_like(a["at.g"], np.nan)}), "not finite"),
        (lambda w, a: a.update({"events.0": a["events.0"][:, 1:]}), "'events.0' has shape"),
        (lambda w, a: w.update(rows=w["rows"][:-1]), "5 points and 4 rows"),
        (lambda w, a: w["rows"][2].pop("energy"), "not the same columns"),
        (lambda w, a: w["events"][0].update(point=9), "point 9 of 5"),
        (lambda w, a: w["events"][0].update(kind="cusp"), "called 'cusp'"),
        (lambda w, a: w["continuation"].update(n_points=7), "7 points.*holds 5 points"),
        (lambda w, a: w["continuation"].update(accepted=1), "goes on after 1 steps"),
        (lambda w, a: w["continuation"].update(length=0.0), "length 0.0"),
        (lambda w, a: w.update(result="lost"), "ends for 'lost'"),
        (lambda w, a: w.update(parameter="length"), "along 'length'"),
        (lambda w, a: w.update(degree=1), "degree 1"),
    ],
)
def test_parts_that_do_not_fit_are_told(whole, change, message):
    words, arrays = broken(whole[0], change)
    with pytest.raises((ValueError, LookupError), match=message):
        branch_of(words, copy.copy(arrays))

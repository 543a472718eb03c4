"""Equilibria and branches from case files: complete folders, true numbers, named endings."""

import dataclasses
import json
import os
import shutil
import signal
from typing import Any

import equinox as eqx
import numpy as np
import pytest

from jaxwillmore import equilibria
from jaxwillmore.cases import CaseError, load_case
from jaxwillmore.health import _warnings
from jaxwillmore.io import RunFolderError, read_history, read_surface
from jaxwillmore.runs import run_branch, run_equilibrium
from jaxwillmore.runs._doubts import doubts, unstable

BASE = {
    "surface": {"shape": "ellipsoid", "semi_axes": [1.0, 1.0, 2.0], "level": 1},
    "constraints": {"area": "initial", "reduced_volume": 0.8},
    "output": {"picture": False},
}
BRANCH = {"stop": 0.79, "step0": 0.01}


def case_of(command: Any = "equilibrium", **sections):
    keys = {name: {**BASE.get(name, {}), **sections.get(name, {})} for name in {*BASE, *sections}}
    keys = {name: {k: v for k, v in table.items() if v is not None} for name, table in keys.items()}
    return load_case(keys, command)


# 1. Equilibria.


@pytest.fixture(scope="module")
def vesicle(tmp_path_factory):
    rows = []
    out = tmp_path_factory.mktemp("equilibria") / "deep" / "vesicle"
    case = case_of(output={"picture": True, "self_intersection": True})
    return case, run_equilibrium(case, out, progress=rows.append), rows


def test_the_folder_of_an_equilibrium_is_complete(vesicle):
    case, run, rows = vesicle
    assert {path.name for path in run.folder.iterdir()} == {
        *(".files", "case.toml", "summary.json"),
        *("final.npz", "final.ply", "final.vtu", "final.png"),
    }
    assert load_case(run.folder / "case.toml", "equilibrium") == case
    assert len(rows) == run.summary["steps"] and run.succeeded
    _, x = read_surface(run.folder / "final.npz")
    np.testing.assert_array_equal(x, run.shape.x)


def test_the_summary_of_an_equilibrium_says_what_the_shape_says(vesicle):
    _, run, _ = vesicle
    summary = json.loads((run.folder / "summary.json").read_text(encoding="utf-8"))
    assert summary == run.summary
    shape = run.shape
    assert summary["status"] == "converged" and summary["negative_directions"] == 0
    # The axisymmetric reference; 162 nodes are 5e-4 above it.
    assert summary["bending_over_8pi_kappa"] == pytest.approx(1.387440, abs=1e-3)
    assert summary["stationarity"] < 1e-9
    of = summary["multipliers"]
    assert of["tension"] == float(shape.tension) and of["pressure"] == float(shape.pressure)
    assert of["scaled_tension"] == pytest.approx(float(shape.scaled_tension), rel=1e-12)
    assert of["scaled_pressure"] == pytest.approx(float(shape.scaled_pressure), rel=1e-12)
    np.testing.assert_allclose(summary["reduced_volume"], 0.8, rtol=1e-12)
    assert summary["health"] == []


@pytest.mark.slow
def test_osmosis_replaces_a_held_volume(vesicle, tmp_path):
    """The solute that balances the multiplier at v = 0.8 gives v = 0.8."""
    _, held, _ = vesicle
    n = held.summary["volume"] * (1.0 + held.summary["multipliers"]["pressure"] / 10.0)
    osmotic = {"solute_amount": n, "ambient_concentration": 1.0}
    osmotic |= {"temperature": 10.0, "gas_constant": 1.0}
    case = case_of(constraints={"reduced_volume": None}, energy={"osmotic": osmotic})
    run = run_equilibrium(case, tmp_path / "out")
    # Another way to the same shape: equal up to the change of reference surfaces.
    assert run.summary["reduced_volume"] == pytest.approx(0.8, abs=1e-4)
    pressure = 10.0 * (n / run.summary["volume"] - 1.0)
    assert run.summary["multipliers"]["pressure"] == pytest.approx(pressure, rel=1e-9)


def test_a_search_that_settles_nowhere_leaves_its_last_shape(tmp_path, monkeypatch):
    import jaxwillmore.runs._equilibrium as module

    short = lambda *a, **k: equilibria.equilibrium(*a, **k, max_outer=1)
    monkeypatch.setattr(module, "equilibrium", short)
    run = run_equilibrium(case_of(), tmp_path / "out")
    assert run.summary["status"] == "not_settled" and not run.succeeded
    assert run.summary["negative_directions"] is None
    assert (run.folder / "final.vtu").is_file()


def test_a_warning_is_fatal_where_the_case_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(_warnings, "UNRESOLVED", 1e-9)
    for fatal in (False, True):
        run = run_equilibrium(case_of(output={"fatal_warnings": fatal}), tmp_path / str(fatal))
        (found,) = run.summary["health"]
        assert found["kind"] == "unresolved_curvature" and found["value"] > found["limit"] == 1e-9
        assert run.summary["status"] == ("unhealthy" if fatal else "converged")
        assert run.succeeded != fatal


@pytest.mark.parametrize("command", ["equilibrium", "branch"])
def test_the_reduced_volume_of_the_sphere_is_refused_before_anything_is_made(command, tmp_path):
    sections = {"constraints": {"reduced_volume": 1.0}, "branch": BRANCH}
    with pytest.raises(CaseError, match="reduced_volume: must be less than 1; got 1.*only shape"):
        compute = run_equilibrium if command == "equilibrium" else run_branch
        compute(case_of(command, **sections), tmp_path / "out")
    with pytest.raises(CaseError, match="stop: must be less than 1"):
        run_branch(case_of("branch", branch={"stop": 1.0}), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_shapes_that_are_no_minima_are_told(vesicle):
    _, run, _ = vesicle
    assert run.summary["negative_directions"] == 0 and run.summary["warnings"] == []
    saddle = eqx.tree_at(lambda shape: shape.negative_directions, run.shape, 2)
    (words,) = unstable([saddle])
    assert "no minimum" in words and "2 independent directions" in words
    (words,) = unstable([run.shape, saddle, saddle])
    assert words.startswith("2 of 3 shapes are stationary")


def test_a_symmetry_that_was_to_be_kept_is_missed(vesicle):
    _, run, _ = vesicle
    assert doubts([run.shape]) == [] and run.summary["lost_symmetry"] == []
    stats = run.shape.stats | {"search": "stationary", "lost": ("body of revolution",)}
    (words,) = doubts([dataclasses.replace(run.shape, stats=stats)])
    assert "lost (body of revolution)" in words


def interrupt_at(name, value, number=signal.SIGTERM):
    """A progress function that sends a signal where the record says so."""
    return lambda row: os.kill(os.getpid(), number) if row.get(name) == value else None


def test_an_interrupted_search_keeps_its_last_accepted_shape(vesicle, tmp_path):
    _, _, rows = vesicle
    case = case_of()
    run = run_equilibrium(case, tmp_path / "out", progress=interrupt_at("step", 2))
    assert run.summary["status"] == "interrupted" and not run.succeeded
    assert rows[1]["accepted"] and run.summary["steps"] == 2
    assert json.loads((run.folder / "summary.json").read_text())["status"] == "interrupted"
    _, x = read_surface(run.folder / "final.npz")
    np.testing.assert_array_equal(x, run.shape.x)
    # The same search went on from there: its second step is what was kept.
    second = rows[1]["energy_over_8pi_kappa"]
    assert run.summary["bending_over_8pi_kappa"] == pytest.approx(second, rel=1e-9)
    with pytest.raises(RunFolderError, match="earlier run"):
        run_equilibrium(case, tmp_path / "out")
    assert run_equilibrium(case, tmp_path / "out", existing="replace").succeeded


def test_an_interrupt_is_why_it_ended_whatever_the_warnings_say(tmp_path, monkeypatch):
    monkeypatch.setattr(_warnings, "UNRESOLVED", 1e-9)
    fatal = {"fatal_warnings": True}
    search = run_equilibrium(
        case_of(output=fatal), tmp_path / "search", progress=interrupt_at("step", 1)
    )
    assert search.summary["status"] == "interrupted" and search.summary["health"]
    case = case_of("branch", branch={**BRANCH, "stop": 0.7}, output=fatal)
    branch = run_branch(case, tmp_path / "branch", progress=interrupt_at("point", 0))
    assert branch.summary["status"] == "interrupted" and branch.summary["health"]
    assert branch.summary["points"] == 1


# 2. Branches.


@pytest.fixture(scope="module")
def prolates(tmp_path_factory):
    rows = []
    out = tmp_path_factory.mktemp("branches") / "prolates"
    case = case_of("branch", branch=BRANCH, output={"picture": True})
    return case, run_branch(case, out, progress=rows.append), rows


def test_the_folder_of_a_branch_is_complete(prolates):
    case, run, _ = prolates
    assert {path.name for path in run.folder.iterdir()} == {
        *(".files", "case.toml", "summary.json", "branch.csv", "branch.png", "shapes"),
        "checkpoint.npz",
        *("final.npz", "final.ply", "final.vtu", "final.png"),
    }
    assert load_case(run.folder / "case.toml", "branch") == case
    shapes = sorted((run.folder / "shapes").iterdir())
    assert len(shapes) == len(run.points) == run.summary["points"]
    for path, point in zip(shapes, run.points, strict=True):
        np.testing.assert_array_equal(read_surface(path)[1], point.x)


def test_the_table_of_a_branch_ends_at_its_stop(prolates):
    _, run, rows = prolates
    table = read_history(run.folder / "branch.csv")
    assert table == [row for row in rows if "point" in row]
    assert run.succeeded and run.summary["status"] == "end_reached"
    np.testing.assert_allclose(table[-1]["reduced_volume"], 0.79, rtol=1e-10)
    assert run.summary["ended_at"]["reduced_volume"] == table[-1]["reduced_volume"]
    energies = [row["bending_over_8pi_kappa"] for row in table]
    assert all(b > a for a, b in zip(energies[:-1], energies[1:], strict=True))


def test_a_branch_that_ends_early_says_where_and_keeps_its_shapes(tmp_path):
    case = case_of("branch", branch={**BRANCH, "stop": 0.7, "max_points": 1})
    run = run_branch(case, tmp_path / "out")
    assert run.summary["status"] == "point_limit" and not run.succeeded
    assert "max_points" in run.summary["message"]
    assert 0.7 < run.summary["ended_at"]["reduced_volume"] < 0.8
    assert len(list((run.folder / "shapes").iterdir())) == run.summary["points"] == 2


def test_an_interrupted_branch_keeps_its_points(tmp_path):
    case = case_of("branch", branch={**BRANCH, "stop": 0.7}, output={"picture": True})
    run = run_branch(case, tmp_path / "out", progress=interrupt_at("point", 1, signal.SIGINT))
    assert run.summary["status"] == "interrupted" and not run.succeeded
    assert run.summary["points"] == 2 and "All its points are kept" in run.summary["message"]
    assert run.summary["events"] == []
    assert json.loads((run.folder / "summary.json").read_text()) == run.summary
    table = read_history(run.folder / "branch.csv")
    assert len(table) == len(list((run.folder / "shapes").iterdir())) == 2
    assert run.summary["ended_at"] == table[-1]
    _, x = read_surface(run.folder / "final.npz")
    np.testing.assert_array_equal(x, run.points[-1].x)
    assert (run.folder / "branch.png").is_file() and (run.folder / "final.png").is_file()


@pytest.mark.slow
def test_a_branch_interrupted_before_its_first_point_has_none(tmp_path):
    case = case_of("branch", branch=BRANCH, output={"picture": True})
    run = run_branch(case, tmp_path / "out", progress=interrupt_at("step", 1))
    assert run.summary["status"] == "interrupted" and run.summary["points"] == 0
    assert "no equilibrium to start from" in run.summary["message"]
    assert (run.folder / "final.npz").is_file() and not (run.folder / "branch.csv").exists()


def test_a_branch_ends_where_it_needs_less_than_its_smallest_step(tmp_path):
    branch = {"stop": 0.3, "step0": 0.49, "max_step": 0.49, "min_step": 0.4}
    run = run_branch(case_of("branch", branch=branch), tmp_path / "out")
    assert run.summary["status"] == "step_too_small" and run.summary["points"] == 1


def test_a_fatal_warning_ends_a_branch_at_its_point(tmp_path, monkeypatch):
    monkeypatch.setattr(_warnings, "UNRESOLVED", 1e-9)
    case = case_of("branch", branch={**BRANCH, "stop": 0.7}, output={"fatal_warnings": True})
    run = run_branch(case, tmp_path / "out")
    assert run.summary["status"] == "unhealthy" and run.summary["points"] == 1
    assert run.summary["health"][0]["point"] == 0


def test_an_earlier_branch_is_replaced_whole(prolates, tmp_path):
    """The first has more points: none of them stays among those of the second."""
    case, first, _ = prolates
    out = tmp_path / "out"
    shutil.copytree(first.folder, out)
    short = interrupt_at("point", 0)
    second = run_branch(case, out, existing="replace", progress=short)
    assert len(list((out / "shapes").iterdir())) == len(second.points) < len(first.points)


# 3. Refusals, before anything is computed.


@pytest.mark.parametrize(
    "sections, words",
    [
        ({"constraints": {"area": None, "reduced_volume": None}}, ["nothing decides the size"]),
        ({"energy": {"tension": 1.0}}, ["[energy] tension", "multiplier"]),
        ({"energy": {"pressure": 1.0}}, ["[energy] pressure", "multiplier"]),
        ({"flow": {"kind": "mean-curvature"}}, ["[flow] kind", "willmore"]),
        ({"constraints": {"ramp": 1.0}}, ["ramp", "flows"]),
        (
            {"constraints": {"reduced_volume": None, "volume": 1e3, "area": "initial"}},
            ["[constraints]", "at most volume"],
        ),
    ],
)
def test_what_has_no_equilibrium_is_refused(tmp_path, sections, words):
    with pytest.raises(CaseError) as caught:
        run_equilibrium(case_of(**sections), tmp_path / "out")
    for word in words:
        assert word in str(caught.value), str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "sections, words",
    [
        ({"branch": {**BRANCH, "parameter": "pressure"}}, ["[branch] parameter", "free volume"]),
        (
            {"branch": BRANCH, "constraints": {"reduced_volume": None}},
            ["[branch] parameter", "area and volume held"],
        ),
        ({"branch": {"stop": 1.2}}, ["[branch] stop", "<= 1"]),
        ({"branch": {}}, ["[branch] stop", "missing"]),
        ({"branch": {**BRANCH, "min_step": 0.02}}, ["[branch] min_step", "<= step0 = 0.01"]),
        ({}, ["[branch] is missing"]),
    ],
)
def test_what_has_no_branch_is_refused(tmp_path, sections, words):
    with pytest.raises(CaseError) as caught:
        run_branch(case_of("branch", **sections), tmp_path / "out")
    for word in words:
        assert word in str(caught.value), str(caught.value)
    assert not (tmp_path / "out").exists()

"""Cases of time series: what is read, what is refused before the run, what a folder holds."""

import json
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.cases import CaseError, FlowModelCase, load_fit
from jaxwillmore.cli import main
from jaxwillmore.evolve import evolve
from jaxwillmore.flows import Loads, MinimalDeformation, WillmoreFlow
from jaxwillmore.io import RunFolder, write_npz
from jaxwillmore.mesh import SurfaceError, ellipsoid, icosphere, torus
from jaxwillmore.runs import run_fit
from jaxwillmore.runs._fit_series import FlowOfCase

MESH, X = ellipsoid((1.0, 1.2, 1.5), 0, 2)
TIMES, MODULUS = (0.01, 0.03), 0.7

CASE = """
[target]
file = ["0.npz", "1.npz", "2.npz"]
times = [0.5, 0.51, 0.53]
[flow]
bending_modulus = 0.6
tangential = "none"
[fit]
method = "series"
rtol = 1e-3
"""


def tables(target=(), flow=(), fit=()):
    """A case of two surfaces with changes."""
    return {
        "target": {"file": ["a.npz", "b.npz"], "times": [0.0, 1.0]} | dict(target),
        "flow": dict(flow),
        "fit": {"method": "series"} | dict(fit),
    }


def test_a_series_is_complete_and_reads_back_the_same(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text(CASE)
    task = load_fit(path)
    assert task.target.file[2] == str(tmp_path / "2.npz")
    assert task.fit.free == ("bending_modulus",) and task.fit.shared == ()
    assert load_fit(task.to_toml()) == task
    assert "[model]" not in task.to_toml()
    begun = load_fit(tables({"start": "s.npz", "times": [1.0, 2.0]}, {"hold": ["area"]}))
    assert load_fit(begun.to_toml()) == begun


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": {"times": [1.0, 0.5]}}, r"\[target\] times: must be a list of rising numbers"),
        ({"target": {"times": [0.0, float("nan")]}}, "rising numbers"),
        ({"target": {"times": [0.0, 1.0, 2.0]}}, "3 times for 2 files"),
        ({"target": {"times": None}}, r"\[target\] times: is missing"),
        ({"target": {"file": "a.npz", "times": [0.0]}}, "has one surface"),
        ({"target": {"start": "s.npz"}}, "must be after 0"),
        ({"fit": {"free": ["reduced_volume"]}}, 'with method = "series"'),
        ({"fit": {"free": []}}, r"\[fit\] free: must be"),
        ({"fit": {"both_ways": False}}, r'\[fit\] both_ways: is for method = "match"'),
        ({"fit": {"method": "match"}}, 'write method = "series"'),
        ({"flow": {"hold": ["area"], "tension": 1.0}}, "the tension follows"),
        ({"flow": {"hold": ["volume"]}, "fit": {"free": ["pressure"]}}, "the pressure follows"),
        ({"flow": {"bending_modulus": -1.0}}, r"\[flow\] bending_modulus"),
    ],
)
def test_what_makes_no_sense_is_refused(changes, message):
    with pytest.raises(CaseError, match=message):
        load_fit(tables(**changes))


def test_a_series_has_no_equilibrium_and_a_shape_no_flow():
    with pytest.raises(CaseError, match=r"\[model\]: is for method = \"match\""):
        load_fit(tables() | {"model": {"kind": "oblate"}})
    with pytest.raises(CaseError, match=r"\[flow\]: is for method = \"series\""):
        load_fit({"target": {"file": "a"}, "flow": {"tension": 1.0}})


@pytest.mark.parametrize(
    ("later", "error", "message"),
    [
        ((MESH, np.nan * np.asarray(X)), (CaseError, SurfaceError), "(?s)1.npz.*finite"),
        (icosphere(1, degree=2), CaseError, "1.npz has other triangles than .*0.npz"),
        ((MESH, -X), (CaseError, SurfaceError), "(?s)1.npz.*inward"),
    ],
)
def test_surfaces_that_make_no_series_are_refused_before_the_run(tmp_path, later, error, message):
    write_npz(tmp_path / "0.npz", MESH, X)
    write_npz(tmp_path / "1.npz", *later)
    files = [str(tmp_path / f"{k}.npz") for k in (0, 1)]
    with pytest.raises(error, match=message):
        run_fit(load_fit(tables({"file": files})), tmp_path / "out")


def test_a_flow_does_not_change_the_genus(tmp_path):
    write_npz(tmp_path / "0.npz", MESH, X)
    write_npz(tmp_path / "1.npz", *torus(1.0, 0.4, level=0))
    files = [str(tmp_path / f"{k}.npz") for k in (0, 1)]
    with pytest.raises(CaseError, match="genus 1 and the start 0"):
        run_fit(load_fit(tables({"file": files, "same_mesh": False})), tmp_path / "out")


def test_parameters_go_where_they_belong():
    """Free ones are those of the call, the others those of the case."""
    case = FlowModelCase(spontaneous_curvature=0.3, tension=2.0, hold=("volume",))
    build = FlowOfCase(("bending_modulus", "tension"), case, None, 4.0)
    free = {"bending_modulus": jnp.asarray(0.2), "tension": jnp.asarray(3.0)}
    law, loads, motion = cast(Any, build(free).laws)
    assert isinstance(law, WillmoreFlow) and isinstance(motion, MinimalDeformation)
    assert (float(law.bending_modulus), float(law.spontaneous_curvature)) == (0.2, 0.3)
    assert isinstance(loads, Loads) and float(cast(Any, loads.energy).surface_tension) == 3.0
    assert loads.area is None and float(cast(Any, loads.volume)) == 4.0
    plain = FlowOfCase(("bending_modulus",), FlowModelCase(tangential="none"), None, None)
    (law,) = plain({"bending_modulus": jnp.asarray(0.2)}).laws
    assert isinstance(law, WillmoreFlow)


@pytest.mark.slow
def test_the_command_line_finds_the_modulus_and_resumes(tmp_path, capsys):
    """Surfaces of a flow with b_b = 0.7, first seen at t = 0.5."""
    run = evolve(WillmoreFlow(MODULUS), MESH, X, t1=TIMES[-1], rtol=1e-4, saveat=TIMES)
    for k, x in enumerate([X, *(state.x for state in run.saved[-len(TIMES) :])]):
        write_npz(tmp_path / f"{k}.npz", MESH, x)
    (tmp_path / "fit.toml").write_text(CASE)
    out = tmp_path / "out"
    command = ["fit", str(tmp_path / "fit.toml"), "--out", str(out)]
    assert main(command) == 0
    assert "step   1" in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text())
    # Steps of rtol = 1e-3; the data have a tenth of that.
    found = summary["parameters"]["bending_modulus"]
    np.testing.assert_allclose(found, MODULUS, rtol=3e-3)
    assert [shape["time"] for shape in summary["shapes"]] == [0.51, 0.53]
    assert all(shape["distances"]["rms"] < 1e-3 for shape in summary["shapes"])
    assert "mobility" in summary["in_words"][0]
    for name in ("overlay_1.png", "residual_1.png", "profile.png", "final_1.npz"):
        assert (out / name).exists()
    # It goes on from its last iterate, and finds nothing left to do.
    (tmp_path / "fit.toml").write_text(CASE + "picture = false\n")
    assert main([*command, "--resume"]) == 0
    assert f"bending_modulus {found:.6g}" in capsys.readouterr().out.splitlines()[0]
    again = json.loads((out / "summary.json").read_text())["parameters"]["bending_modulus"]
    np.testing.assert_allclose(again, found, rtol=1e-4)


def test_a_broken_iterate_is_told(tmp_path):
    """An iterate of another kind of fit in the folder."""
    for k in range(3):
        write_npz(tmp_path / f"{k}.npz", MESH, X)
    (tmp_path / "fit.toml").write_text(CASE)
    for text, message in (("[]", "no values of bending_modulus"), ("{", "cannot be read")):
        with RunFolder(tmp_path / "out", "resume") as folder:
            folder.file("iterate.json").write_text(text)
        with pytest.raises(CaseError, match=message):
            run_fit(load_fit(tmp_path / "fit.toml"), tmp_path / "out", existing="resume")

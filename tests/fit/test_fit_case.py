"""Cases of fits: what is read, what is refused, what a folder holds afterwards."""

import json
import os
import signal

import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.cases import (
    CaseError,
    example_names,
    example_path,
    fit_example_names,
    is_example,
    load_case,
    load_fit,
)
from jaxwillmore.cli import main
from jaxwillmore.energies import Willmore
from jaxwillmore.equilibria import equilibrium, spheroid
from jaxwillmore.io import read_surface, write_npz
from jaxwillmore.mesh import raise_degree, torus
from jaxwillmore.runs import run_fit

from ..helpers import random_rotation
from .profiles import OBLATE, equilibrium_nodes

CASE = """
[target]
file = "cell.npz"
[model]
kind = "oblate"
level = 1
[fit]
free = ["reduced_volume"]
max_steps = 3
"""


def test_a_case_is_complete_and_reads_back_the_same(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text(CASE)
    task = load_fit(path)
    assert task.target.file == (str(tmp_path / "cell.npz"),)
    assert task.fit.free == ("reduced_volume",) and task.fit.shared == (
        "scaled_spontaneous_curvature",
    )
    assert load_fit(task.to_toml()) == task


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({}, r"\[target\] file: is missing"),
        ({"target": {"file": 3}}, "text in quotes"),
        ({"target": {"file": "a"}, "time": {}}, "unknown section"),
        ({"target": {"file": "a", "scale": 1}}, "unknown key"),
        ({"target": {"file": "a"}, "fit": {"free": ["bending_modulus"]}}, "a list of"),
        ({"target": {"file": "a"}, "fit": {"reduced_volume_bounds": [0.9, 0.5]}}, "2 rising"),
        ({"target": {"file": "a"}, "model": {"level": 9}}, "whole number from 1 to 5"),
        ({"target": {"file": "a"}, "model": 3}, "must be a table"),
        ({"target": {"file": "a"}, "fit": {"distance": "angles"}}, '"points", "harmonics"'),
        ({"target": {"file": "a", "smooth": "taubin"}}, r"\[target\] smooth.*harmonics.*fairing"),
        ({"target": {"file": "a", "wavelength": 1.0}}, r"\[target\] wavelength.*fairing"),
        ({"target": {"file": "a"}, "fit": {"max_degree": 1}}, "whole number from 2 to 30"),
    ],
)
def test_what_makes_no_sense_is_refused(tables, message):
    with pytest.raises(CaseError, match=message):
        load_fit(tables)


@pytest.mark.parametrize("name", fit_example_names())
def test_examples_are_valid_fits_and_no_flows(name):
    task = load_fit(f"example:{name}")
    assert load_fit(task.to_toml()) == task
    assert all(example_path(file).is_file() for file in task.target.file if is_example(file))
    assert name not in example_names()
    with pytest.raises(CaseError, match="`jaxwillmore fit` reads it"):
        load_case(f"example:{name}")


def test_there_is_an_example():
    assert fit_example_names() and example_names()


@pytest.fixture
def oblate(tmp_path):
    mesh, x = equilibrium_nodes(*OBLATE, level=1)
    write_npz(tmp_path / "cell.npz", mesh, x)
    return tmp_path


def test_forces_are_balanced_into_a_folder(oblate):
    task = load_fit(
        {
            "target": {"file": str(oblate / "cell.npz")},
            "fit": {"method": "force-balance", "picture": False},
        }
    )
    run = run_fit(task, oblate / "out")
    assert run.succeeded
    summary = json.loads((oblate / "out" / "summary.json").read_text())
    assert summary["parameters"][0]["pressure_over_kappa"] == pytest.approx(OBLATE[2], rel=0.06)
    assert summary["verdict"] == "agrees" and summary["warnings"] == []
    assert summary["in_words"][1].startswith("κ is not identifiable")
    assert (oblate / "out" / "final_0.npz").exists()
    with pytest.raises(OSError, match="earlier run"):
        run_fit(task, oblate / "out")


@pytest.mark.slow
def test_the_command_line_matches_reports_and_resumes(oblate, capsys):
    (oblate / "fit.toml").write_text(CASE)
    command = ["fit", str(oblate / "fit.toml"), "--out", str(oblate / "out")]
    assert main(command) == 1  # three steps are not enough, and the exit status says so
    heard = capsys.readouterr()
    assert "raise `max_steps`" in heard.err and "step   0" in heard.out
    first = json.loads((oblate / "out" / "iterate.json").read_text())
    (oblate / "fit.toml").write_text(CASE.replace("= 3", "= 60"))
    assert main([*command, "--resume", "--quiet"]) == 0
    summary = json.loads((oblate / "out" / "summary.json").read_text())
    found = summary["shapes"][0]["parameters"]["reduced_volume"]
    before = first["parameters"][0]["reduced_volume"]
    # The oblate of the shape equations, of reduced volume 0.65 (162 nodes).
    assert abs(found - 0.65) < min(0.01, abs(before - 0.65) + 0.01)
    for name in ("overlay_0.png", "residual_0.png", "profile.png", "final_0.npz"):
        assert (oblate / "out" / name).exists()
    low, high = summary["intervals_95_if_the_model_were_right"]["reduced_volume"]
    assert low < found < high and np.isfinite(summary["rms_over_R0"])


def test_nothing_to_resume_is_said(oblate, capsys):
    (oblate / "fit.toml").write_text(CASE)
    command = ["fit", str(oblate / "fit.toml"), "--out", str(oblate / "new"), "--resume"]
    assert main(command) == 2
    assert "no fit to resume" in capsys.readouterr().err


@pytest.mark.slow
def test_an_interrupted_fit_ends_with_130_keeps_its_iterate_and_resumes(oblate, capsys):
    (oblate / "fit.toml").write_text(CASE.replace("max_steps = 3", "max_steps = 60"))
    task = load_fit(oblate / "fit.toml")

    def interrupt(row):
        if row["step"] == 1:
            os.kill(os.getpid(), signal.SIGTERM)

    run = run_fit(task, oblate / "out", progress=interrupt)
    assert run.summary["status"] == "interrupted" and run.summary["steps"] == 1
    assert json.loads((oblate / "out" / "summary.json").read_text())["status"] == "interrupted"
    assert (oblate / "out" / "iterate.json").exists() and (oblate / "out" / "final_0.npz").exists()
    assert (oblate / "out" / "overlay_0.png").exists()
    assert not (oblate / "out" / "profile.png").exists()  # it would be new work
    command = ["fit", str(oblate / "fit.toml"), "--out", str(oblate / "out"), "--quiet"]
    assert main(command) == 2
    assert "--replace, or --resume" in capsys.readouterr().err
    assert main([*command, "--resume"]) == 0
    summary = json.loads((oblate / "out" / "summary.json").read_text())
    assert summary["status"] == "converged"


@pytest.mark.slow
def test_a_fit_interrupted_before_its_first_step_says_so(oblate, monkeypatch):
    from jaxwillmore.fit import _matcher

    def interrupted_equilibrium(*arguments, **options):
        os.kill(os.getpid(), signal.SIGTERM)
        return equilibrium(*arguments, **options)

    monkeypatch.setattr(_matcher, "equilibrium", interrupted_equilibrium)
    run = run_fit(load_fit(CASE.replace("cell.npz", str(oblate / "cell.npz"))), oblate / "out")
    assert run.summary["status"] == "interrupted" and not run.succeeded
    assert run.summary["shapes"] == []


@pytest.mark.parametrize("smooth", ["harmonics", pytest.param("fairing", marks=pytest.mark.slow)])
def test_rough_targets_are_smoothed_and_the_summary_says_so(tmp_path, smooth):
    """Noise of 1 % at the vertices of an oblate: at most half of its energy is left."""
    mesh, x = equilibrium_nodes(*OBLATE, level=2)
    noise = 1 + 0.01 * np.random.default_rng(0).normal(size=(mesh.n_vertices, 1))
    vertices = np.asarray(x)[: mesh.n_vertices] * noise
    rough = raise_degree(np.asarray(mesh.triangles), vertices, 1)
    write_npz(tmp_path / "a.npz", *rough)
    tables = {
        "target": {"file": str(tmp_path / "a.npz"), "smooth": smooth},
        "fit": {"method": "force-balance", "picture": False},
    }
    summary = run_fit(load_fit(tables), tmp_path / "out").summary
    (act,) = summary["repairs"]
    assert act.startswith("a.npz: smoothed by")
    assert "forces of a surface that was smoothed are too weak" in summary["warnings"][-1]
    exact = float(Willmore()(mesh, x))
    found = float(Willmore()(*read_surface(tmp_path / "out" / "final_0.npz")))
    raw = float(Willmore()(*raise_degree(*rough, 2)))
    assert raw > 1.1 * exact
    assert abs(found - exact) < 0.5 * (raw - exact)


def test_a_target_that_cannot_be_smoothed_is_named(tmp_path):
    write_npz(tmp_path / "torus.npz", *torus(2.0, 1.0, level=2, degree=1))
    tables = {"target": {"file": str(tmp_path / "torus.npz"), "smooth": "harmonics"}}
    with pytest.raises(CaseError, match=r"(?s)\[target\] smooth.*torus.npz.*genus 0.*fairing"):
        run_fit(load_fit(tables), tmp_path / "out")


@pytest.mark.slow
def test_a_cell_in_pixels_tells_its_reduced_volume(tmp_path):
    """An equilibrium at 0.8, turned, moved and 37 times as large: the interval holds 0.8."""
    mesh, x = spheroid(0.8, level=1)
    shape = equilibrium(mesh, x, reduced_volume=0.8, stability=False)
    moved = 37 * np.asarray(shape.x) @ np.asarray(random_rotation(jr.key(3))).T + [120.0, 80.0, 9.0]
    vertices = moved[: mesh.n_vertices]
    write_npz(tmp_path / "cell.npz", *raise_degree(np.asarray(mesh.triangles), vertices, 1))
    text = CASE.replace("oblate", "prolate").replace(
        "level = 1", "level = 1\nreduced_volume = 0.75"
    )
    (tmp_path / "fit.toml").write_text(
        text.replace("max_steps = 3", "tolerance = 1e-5\npicture = false")
    )
    run = run_fit(load_fit(tmp_path / "fit.toml"), tmp_path / "out")
    low, high = run.summary["intervals_95_if_the_model_were_right"]["reduced_volume"]
    assert low < 0.8 < high, (low, high)
    assert run.summary["verdict"] == "agrees", run.summary["warnings"]

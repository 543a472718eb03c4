"""A run leaves a complete folder, however it ends."""

import hashlib
import json
import math
import os
import signal

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore._closing import flow_closing
from jaxwillmore.cases import CaseError, example_path, load_case
from jaxwillmore.health import _warnings
from jaxwillmore.io import PvdSeries, RunFolderError, read_history, read_surface, write_ply
from jaxwillmore.mesh import SurfaceError, icosphere, quality
from jaxwillmore.runs import run_case
from jaxwillmore.runs._start import starting_surface
from jaxwillmore.surface import area, centroid, volume

SURFACE = {"shape": "ellipsoid", "semi_axes": [1.0, 1.0, 1.3], "level": 1, "degree": 1}


def case_of(**sections):
    """The case of most tests: one mesh, so that its step is compiled once."""
    base = {
        "surface": SURFACE,
        "flow": {"tangential": "none"},
        "time": {"t1": 0.02, "dt0": 1e-3},
        "output": {"every": 0.01, "picture": False},
    }
    keys = {name: {**base.get(name, {}), **sections.get(name, {})} for name in {*base, *sections}}
    return load_case(keys)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A short good run with everything switched on."""
    rows = []
    out = tmp_path_factory.mktemp("runs") / "deep" / "good"
    case = case_of(output={"picture": True})
    return case, run_case(case, out, progress=rows.append), rows


# 1. A good run.


def test_the_folder_is_complete_and_nothing_else_is_in_it(finished):
    _, run, _ = finished
    assert {path.name for path in run.folder.iterdir()} == {
        ".files",
        "case.toml",
        "checkpoint.npz",
        "frames",
        "final.npz",
        "final.ply",
        "final.png",
        "history.csv",
        "history.png",
        "run.pvd",
        "summary.json",
    }
    for name in ("final.png", "history.png"):
        assert (run.folder / name).read_bytes().startswith(b"\x89PNG")


def test_the_case_in_the_folder_repeats_the_run(finished):
    case, run, _ = finished
    assert load_case(run.folder / "case.toml") == case


def test_frames_are_at_the_times_asked_for(finished):
    _, run, _ = finished
    entries = PvdSeries(run.folder / "run.pvd").entries()
    np.testing.assert_allclose([t for t, _ in entries], [0.0, 0.01, 0.02], rtol=1e-12)
    assert all((run.folder / file).is_file() for _, file in entries)


def test_history_starts_at_the_start_and_has_every_step(finished):
    _, run, rows = finished
    history = read_history(run.folder / "history.csv")
    assert history[1:] == rows
    assert [row["step"] for row in history] == list(range(run.summary["steps"] + 1))
    times = np.array([row["t"] for row in history])
    assert times[0] == 0.0 and times[-1] == 0.02
    np.testing.assert_allclose(np.diff(times), [row["dt"] for row in rows], rtol=1e-9)
    assert {
        *("t", "dt", "energy", "willmore", "willmore_of_field", "area", "volume"),
        *("reduced_volume", "min_angle", "max_angle", "normal_length_defect", "normal_distance"),
        *("newton_iterations", "krylov_iterations", "rejected_steps"),
    } <= set(history[0])


def test_energy_falls(finished):
    _, run, _ = finished
    energy = np.array([row["energy"] for row in read_history(run.folder / "history.csv")])
    assert np.all(np.diff(energy) < 0)


def test_summary_has_what_it_promises(finished):
    _, run, _ = finished
    summary = json.loads((run.folder / "summary.json").read_text(encoding="utf-8"))
    assert summary == run.summary
    assert summary["status"] == "reached_t1" and run.succeeded
    assert {
        *("status", "t", "steps", "rejected_steps", "newton_iterations", "willmore"),
        *("willmore_of_field", "energy", "area", "volume", "reduced_volume"),
        *("euler_characteristic", "quality", "nodes", "degree", "wall_seconds", "versions"),
    } <= set(summary)
    keys = {"min_angle", "max_angle", "h_min", "h_max", "chunkiness"}
    assert keys <= set(summary["quality"])
    assert (summary["euler_characteristic"], summary["nodes"], summary["degree"]) == (2, 42, 1)
    assert summary["steps"] == len(read_history(run.folder / "history.csv")) - 1
    assert summary["wall_seconds"] > 0 and summary["versions"]["jax"]


def test_summary_measures_the_surface_in_the_folder(finished):
    _, run, _ = finished
    mesh, x = read_surface(run.folder / "final.npz")
    np.testing.assert_array_equal(x, run.solution.state.x)
    summary = run.summary
    A, V = float(area(mesh, x)), float(volume(mesh, x))
    np.testing.assert_allclose([summary["area"], summary["volume"]], [A, V], rtol=1e-12)
    v = 6 * math.sqrt(math.pi) * V / A**1.5
    np.testing.assert_allclose(summary["reduced_volume"], v, rtol=1e-12)
    assert summary["quality"]["min_angle"] == quality(mesh, x).min_angle
    radii = np.linalg.norm(np.asarray(x) - np.asarray(centroid(mesh, x)), axis=1)
    spread = (radii.max() - radii.min()) / radii.mean()
    np.testing.assert_allclose(summary["radius_spread"], spread, rtol=1e-12)


def test_the_final_triangles_are_those_of_the_final_state(finished):
    _, run, _ = finished
    _, x = read_surface(run.folder / "final.ply")
    np.testing.assert_allclose(x, run.solution.state.x, rtol=1e-12)


# 2. Runs that end otherwise keep what they have.


def test_a_run_at_its_step_limit_says_so(tmp_path):
    run = run_case(case_of(time={"max_steps": 2}), tmp_path / "out")
    assert run.summary["status"] == "step_limit" and not run.succeeded
    assert "max_steps" in run.summary["message"]
    history = read_history(run.folder / "history.csv")
    assert len(history) == 3
    entries = PvdSeries(run.folder / "run.pvd").entries()
    assert entries[-1][0] == history[-1]["t"] == run.summary["t"] < 0.02
    _, x = read_surface(run.folder / "final.npz")
    np.testing.assert_array_equal(x, run.solution.state.x)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_is_complete_up_to_its_last_step(tmp_path, number):
    def interrupt(row):
        if row["step"] == 2:
            os.kill(os.getpid(), number)

    run = run_case(case_of(), tmp_path / "out", progress=interrupt)
    assert run.summary["status"] == "interrupted" and not run.succeeded
    assert run.summary["steps"] == 2
    assert json.loads((run.folder / "summary.json").read_text())["status"] == "interrupted"
    assert PvdSeries(run.folder / "run.pvd").entries()[-1][0] == run.summary["t"]


def test_an_interrupt_is_why_a_run_ended_whatever_the_warnings_say(tmp_path, monkeypatch):
    monkeypatch.setattr(_warnings, "UNRESOLVED", 1e-9)

    def interrupt(row):
        os.kill(os.getpid(), signal.SIGTERM)

    case = case_of(output={"fatal_warnings": True})
    run = run_case(case, tmp_path / "out", progress=interrupt)
    assert run.summary["status"] == "interrupted" and run.summary["health"]
    assert run.summary["steps"] == 1


def test_an_exception_leaves_the_steps_before_it(tmp_path):
    def fail(row):
        if row["step"] == 2:
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        run_case(case_of(), tmp_path / "out", progress=fail)
    assert len(read_history(tmp_path / "out" / "history.csv")) == 3
    assert PvdSeries(tmp_path / "out" / "run.pvd").entries()[0][0] == 0.0
    run = run_case(case_of(), tmp_path / "out", existing="replace")  # the lock is gone
    assert run.succeeded


def test_rejections_are_counted_from_the_start(tmp_path):
    run = run_case(case_of(time={"dt0": 0.02, "rtol": 1e-4}), tmp_path / "out")
    counts = [row["rejected_steps"] for row in read_history(run.folder / "history.csv")]
    assert counts[-1] == run.summary["rejected_steps"] >= 1
    assert counts == sorted(counts)


def test_a_stationary_start_stops_at_once(tmp_path):
    case = case_of(surface={"semi_axes": [1, 1, 1]}, time={"t1": 1e3, "stop_when_stationary": 0.5})
    case = load_case(case.to_toml().replace("every = 0.01", "every = 1e3"))
    run = run_case(case, tmp_path / "out")
    assert run.summary["status"] == "stationary" and run.succeeded and run.summary["t"] < 1e3


def test_frames_can_be_left_out(tmp_path):
    run = run_case(case_of(output={"frames": False}), tmp_path / "out")
    assert not list(run.folder.glob("**/*.vtu")) and not (run.folder / "run.pvd").exists()


# 3. Folders.


def test_an_earlier_run_is_replaced_only_on_request(tmp_path):
    case = case_of(time={"max_steps": 1})
    run_case(case, tmp_path / "out")
    with pytest.raises(RunFolderError, match="earlier run"):
        run_case(case, tmp_path / "out")
    run_case(case, tmp_path / "out", existing="replace")
    assert len(read_history(tmp_path / "out" / "history.csv")) == 2


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for out in (tmp_path / "file", tmp_path / "file" / "out", tmp_path / "file" / "a" / "b"):
        with pytest.raises(RunFolderError, match="file"):
            run_case(case_of(), out)
    assert (tmp_path / "file").read_text() == "mine"


# 4. Surfaces.


def test_a_shape_starts_on_its_exact_surface_with_exact_fields():
    surface = {"shape": "sphere", "radius": 2.0, "level": 1}
    start = starting_surface(load_case({"surface": surface, "time": {"t1": 1.0}}))
    np.testing.assert_allclose(jnp.linalg.norm(start.x, axis=1), 2.0, rtol=1e-14)
    np.testing.assert_allclose(start.initial["H"], 1.0, rtol=1e-12)
    np.testing.assert_allclose(start.initial["nu"], start.x / 2, atol=1e-12)


@pytest.mark.filterwarnings("ignore::jaxwillmore.io.SurfaceWarning")  # a coarse mesh
@pytest.mark.parametrize(
    "level, degree, nodes", [(0, 1, 42), (0, 2, 162), (1, 1, 162), (1, 2, 642)]
)
def test_a_file_is_refined_and_raised(tmp_path, level, degree, nodes):
    write_ply(tmp_path / "ball.ply", *icosphere(1, degree=1))
    surface = {"file": str(tmp_path / "ball.ply"), "level": level, "degree": degree}
    case = load_case({"surface": surface, "time": {"t1": 1.0}})
    start = starting_surface(case)
    assert (start.mesh.n_nodes, start.mesh.degree) == (nodes, degree)
    assert start.initial == {}
    radii = np.linalg.norm(start.x, axis=1)
    # New nodes lie on the smooth lifting: flat facets of this ball would reach down to 0.95.
    np.testing.assert_allclose(radii, 1.0, atol=7e-3)


@pytest.mark.filterwarnings("ignore::jaxwillmore.io.SurfaceWarning")  # a coarse mesh
def test_the_last_state_of_a_run_can_be_the_start_of_another(finished):
    _, run, _ = finished
    for degree in (1, 2):
        surface = {"file": str(run.folder / "final.npz"), "degree": degree}
        start = starting_surface(load_case({"surface": surface, "time": {"t1": 1.0}}))
        n_vertices = start.mesh.n_vertices
        np.testing.assert_allclose(start.x[:n_vertices], run.solution.state.x, rtol=1e-14)


def test_the_example_cell_is_sound():
    start = starting_surface(load_case("example:red_blood_cell"))
    assert start.mesh.euler_characteristic == 2
    np.testing.assert_allclose(float(area(start.mesh, start.x)), 4 * math.pi, rtol=1e-12)
    path = example_path("example:red_blood_cell.npz")
    checksum = hashlib.sha256(path.read_bytes()).hexdigest()
    assert checksum in path.with_name("PROVENANCE.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "sections, words",
    [
        ({"surface": {"semi_axes": [1, 1, 0]}}, ["[surface]", "semi_axes", "positive"]),
        ({"surface": {"semi_axes": [1, -1, 1]}}, ["[surface]", "semi_axes", "positive"]),
        ({"energy": {"spontaneous_curvature": 50.0}}, ["spontaneous_curvature", "got 50", "level"]),
        ({"energy": {"spontaneous_curvature": -50.0}}, ["spontaneous_curvature", "got -50"]),
    ],
)
def test_what_gives_no_surface_is_refused_before_anything_is_written(tmp_path, sections, words):
    with pytest.raises(CaseError) as caught:
        run_case(case_of(**sections), tmp_path / "out")
    for word in words:
        assert word in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_torus_that_meets_itself_is_refused(tmp_path):
    case = load_case(
        {"surface": {"shape": "torus", "minor_radius": 2.0}, "time": {"t1": 1.0}},
    )
    with pytest.raises(CaseError, match="minor_radius"):
        run_case(case, tmp_path / "out")


def test_a_missing_and_a_broken_mesh_are_told_apart(tmp_path):
    (tmp_path / "broken.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    for name, error in {"none.ply": FileNotFoundError, "broken.off": SurfaceError}.items():
        case = load_case({"surface": {"file": str(tmp_path / name)}, "time": {"t1": 1.0}})
        with pytest.raises(error, match=name):
            run_case(case, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_small_vesicle_grows_to_the_size_of_its_curvature(tmp_path):
    """With H0 = 1 a sphere of R = 0.2 grows to R = 1.5 at t = 1.4187: Ṙ = (2 − H0 R) H0 / R²."""
    case = load_case(
        """
        [surface]
        shape = "sphere"
        radius = 0.2
        level = 1
        [energy]
        spontaneous_curvature = 1.0
        [time]
        t1 = 1.4187
        [output]
        picture = false
        frames = false
        """
    )
    run = run_case(case, tmp_path / "out")
    assert run.summary["area"] == pytest.approx(4 * math.pi * 1.5**2, rel=0.01)


def test_a_run_with_new_meshes_tells_of_them(tmp_path):
    """Frames know their triangles; what was refused is a note."""
    section = {"remesh_when": 44.0, "remesh_every": 2, "remesh_energy_change": 0.2}
    longer = {"semi_axes": [1.0, 1.0, 1.8]}
    case = case_of(surface=longer, mesh=section, output={"every": 0.005})
    run = run_case(case, tmp_path / "out")
    told = run.summary["remeshings"]
    assert told and told[0]["step"] == 2 and {"t", "energy", "area", "volume"} < set(told[0])
    assert abs(told[0]["restored_area"]) < 1e-12
    assert f"{len(told)} new mesh" in flow_closing(run.summary)
    frames = sorted((run.folder / "frames").iterdir())
    first, last = (read_surface(path)[0].cells for path in (frames[0], frames[-1]))
    assert not np.array_equal(first, last)
    np.testing.assert_array_equal(last, run.solution.mesh.cells)
    _, x = read_surface(run.folder / "final.npz")
    np.testing.assert_array_equal(x, run.solution.state.x)
    strict = case_of(surface=longer, mesh=section | {"remesh_energy_change": 1e-12})
    run = run_case(strict, tmp_path / "strict")
    assert run.summary["remeshings"] == [] and len(run.summary["notes"]) == 1
    assert "not used; the last one because" in run.summary["notes"][0]

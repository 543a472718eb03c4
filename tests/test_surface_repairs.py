"""Defects of a mesh and their remedies through every door: Python, case files, `check`."""

import json
import pathlib
import re

import numpy as np
import pytest

from jaxwillmore.cases import CaseError, load_case
from jaxwillmore.cli import main
from jaxwillmore.energies import Willmore
from jaxwillmore.io import SurfaceWarning, examine_surface, read_surface
from jaxwillmore.mesh import SurfaceError, check_mesh, torus
from jaxwillmore.runs import check_file, run_case
from jaxwillmore.runs._start import starting_surface

from .io.surfaces import ball, obj_text, ply_text, stl_bytes

V, F = ball(1)
v, f = ball(0)
BALL = check_mesh(*read_surface((V, F)))


def joined(*surfaces):
    """Several surfaces in one pair of arrays."""
    starts = np.cumsum([0, *(len(x) for x, _ in surfaces)])
    faces = [cells + start for (_, cells), start in zip(surfaces, starts, strict=False)]
    return np.concatenate([x for x, _ in surfaces]), np.concatenate(faces)


def sliver():
    """Loose triangles two of which have a corner twice, as STL files of CAD programs have them."""
    faces = np.concatenate([[[5, 5, 9]], F[:17], [[3, 7, 3]], F[17:]])
    return stl_bytes(V, faces)


FILES = {
    "unused.ply": ply_text(np.concatenate([V, 9 + V[:2]]), F),
    "two.ply": ply_text(*joined((V, F), (0.4 * v + 3, f))),
    "sliver.stl": sliver(),
    "repeated.obj": obj_text(V, np.concatenate([F, F[3:4]])),
    "turned.obj": obj_text(V, np.concatenate([F[:9, ::-1], F[9:]])),
    "two_cells.obj": obj_text(*joined((V, F), (V + 5, F))),
    "shell.obj": obj_text(*joined((V, F), (0.5 * V, F))),
    "hollow.obj": obj_text(*joined((V, F), (0.5 * V, F[:, ::-1]))),
}
MENDED = {
    "unused.ply": ({"repair": True}, "unreferenced_vertices .*42, 43", r"\(2\): 42, 43"),
    "two.ply": ({"keep": "largest"}, "several_components", "dropped 1 of 2 pieces: 12 vertices"),
    "sliver.stl": ({"repair": True}, "degenerate_faces .* 0, 18", r"twice \(2\): 0, 18"),
    "repeated.obj": ({"repair": True}, "duplicate_faces .* 80", r"repeat .*\(1\): 80"),
    "turned.obj": ({"fix_orientation": True}, "inconsistent_orientation", r"over \(9\)"),
    "hollow.obj": ({"keep": "largest"}, "nested_components", "dropped 1 of 2 pieces"),
}


@pytest.fixture
def folder(tmp_path):
    for name, content in FILES.items():
        data = content.encode() if isinstance(content, str) else content
        (tmp_path / name).write_bytes(data)
    return tmp_path


def in_toml(options):
    words = {True: "true", False: "false"}
    lines = (f"{k} = {words[o] if isinstance(o, bool) else json.dumps(o)}" for k, o in options)
    return "\n".join(lines)


@pytest.mark.parametrize("name", MENDED)
def test_python_mends_what_it_is_asked_to_and_says_so(folder, name):
    options, defect, act = MENDED[name]
    with pytest.raises(SurfaceError) as caught:
        read_surface(folder / name)
    message = str(caught.value)
    assert re.search(defect, message, re.S)
    ((key, _),) = options.items()
    assert f"`{key}=" in message  # the way is in the error
    with pytest.warns(SurfaceWarning, match=act):
        mesh, x = read_surface(folder / name, **options)
    report = check_mesh(mesh, x)
    assert (mesh.n_nodes, mesh.n_cells) == (len(V), len(F))
    assert report.area == pytest.approx(BALL.area, rel=1e-6)
    assert report.volume == pytest.approx(BALL.volume, rel=1e-6)


@pytest.mark.parametrize("name", MENDED)
def test_a_case_file_mends_it_by_a_key_that_the_error_names(folder, name):
    options, _, act = MENDED[name]
    text = f'[surface]\nfile = "{folder / name}"\ndegree = 1\n[time]\nt1 = 1.0\n'
    with pytest.raises(SurfaceError) as caught:
        starting_surface(load_case(text))
    key = in_toml(options.items())
    assert f"`{key}` in [surface]" in str(caught.value)
    case = load_case(text.replace("degree", f"{key}\ndegree"))
    assert load_case(case.to_toml()) == case
    with pytest.warns(SurfaceWarning, match=act):
        start = starting_surface(case)
    assert start.mesh.n_nodes == len(V) and re.search(act, start.repairs[0])


@pytest.mark.parametrize("name", MENDED)
def test_the_command_mends_it_by_options_that_the_report_names(folder, name, capsys):
    _, _, act = MENDED[name]
    assert main(["check", str(folder / name)]) == 1
    said = capsys.readouterr().out
    commands = re.findall(r"`jaxwillmore check MESH (.*?)`", said)
    command = next(c for c in commands if "largest" in c) if "largest" in said else commands[0]
    out = folder / "out.ply"
    assert main(["check", str(folder / name), *command.replace("OUT.ply", str(out)).split()]) == 0
    said = capsys.readouterr().out
    assert re.search(f"repaired: .*{act}", said) and f"written to {out}" in said
    mesh, _ = read_surface(out)
    assert (mesh.n_nodes, mesh.n_cells) == (len(V), len(F))
    before = out.read_bytes()
    assert main(["check", str(folder / name), "--repair", str(out)]) == 2  # nothing is replaced
    assert "is there already" in capsys.readouterr().err and out.read_bytes() == before


def test_several_pieces_are_a_surface_where_that_is_said(folder, capsys):
    text = f'[surface]\nfile = "{folder}/two_cells.obj"\ndegree = 1\ncomponents = 2\n'
    start = starting_surface(load_case(text, "equilibrium"))
    report = check_mesh(start.mesh, start.x, components=2)
    assert report.area == pytest.approx(2 * BALL.area, rel=1e-12)
    assert report.volume == pytest.approx(2 * BALL.volume, rel=1e-12)
    assert start.repairs == ()
    assert main(["check", str(folder / "two_cells.obj"), "--components", "2"]) == 0
    assert main(["check", str(folder / "two_cells.obj"), "--components", "3"]) == 1
    assert main(["check", str(folder / "two_cells.obj"), "--components", "0"]) == 2
    capsys.readouterr()


@pytest.mark.parametrize("repair", [{}, {"fix_orientation": True}, {"repair": True}])
@pytest.mark.parametrize("name", ["shell.obj", "hollow.obj"])
def test_a_piece_inside_another_is_refused_by_name(folder, name, repair):
    with pytest.raises(SurfaceError, match="nested_components"):
        read_surface(folder / name, components=2, **repair)


def test_another_number_of_handles_is_refused_through_every_door(folder, capsys):
    path = folder / "turned.obj"
    options = {"fix_orientation": True, "genus": 1}
    with pytest.raises(SurfaceError, match="unexpected_genus"):
        read_surface(path, **options)
    case = f'[surface]\nfile = "{path}"\n{in_toml(options.items())}\n'
    with pytest.raises(SurfaceError, match="unexpected_genus"):
        starting_surface(load_case(case, "equilibrium"))
    command = ["check", str(path), "--genus", "1", "--repair", str(folder / "out.ply")]
    assert main(command) == 1
    assert "unexpected_genus" in capsys.readouterr().out and not (folder / "out.ply").exists()


def test_a_sound_surface_is_written_as_it_is(folder, capsys):
    (folder / "ball.ply").write_text(ply_text(V, F))
    said = check_file(folder / "ball.ply", folder / "out.npz")
    assert "nothing to repair; written to" in said
    np.testing.assert_array_equal(read_surface(folder / "out.npz")[1], V)


@pytest.mark.parametrize("name, words", [("out.obj", ".ply or .npz"), ("no/out.ply", "no folder")])
def test_a_repaired_mesh_needs_a_place_and_a_format(folder, name, words):
    with pytest.raises(CaseError, match=words):
        check_file(folder / "unused.ply", folder / name)


def test_what_was_repaired_stands_in_the_summary(folder):
    path = folder / "unused.ply"
    case = load_case(
        f'[surface]\nfile = "{path}"\nrepair = true\ndegree = 1\n[flow]\nkind = "mean-curvature"\n'
        "[time]\nt1 = 1e-3\nmax_steps = 1\n[output]\npicture = false\nframes = false\n"
    )
    with pytest.warns(SurfaceWarning, match="dropped vertices without a face"):
        run = run_case(case, folder / "out")
    written = json.loads((pathlib.Path(run.folder) / "summary.json").read_text())
    assert written["repairs"] == ["dropped vertices without a face (2): 42, 43"]


@pytest.mark.parametrize(
    "key", ["repair = true", 'keep = "largest"', "components = 2", "genus = 0"]
)
def test_repairs_are_for_files(key):
    with pytest.raises(CaseError, match="from a file"):
        load_case(f'[surface]\nshape = "sphere"\n{key}\n[time]\nt1 = 1.0\n')


def test_the_report_of_a_file_comes_without_warnings(folder):
    reading = examine_surface(folder / "unused.ply", repair=True)
    assert reading.report.ok and len(reading.repairs) == 1


def test_a_case_file_that_cannot_be_read_is_all_that_is_spoken_of(tmp_path, capsys):
    path = tmp_path / "a.toml"
    path.write_text(f'[surface]\nshape = "sphere"\nlevel = {"9" * 5000}\n')
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "a.toml: is not valid TOML" in err


def test_encodings_of_case_files_are_named(tmp_path):
    text = '[surface]\nshape = "sphere"\n[time]\nt1 = 0,01\n'
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(CaseError, match="line 4"):
        load_case(tmp_path / "a.toml")
    (tmp_path / "a.toml").write_bytes(text.replace(",", ".").encode("utf-16"))
    with pytest.raises(CaseError, match="UTF-16"):
        load_case(tmp_path / "a.toml")
    (tmp_path / "a.toml").write_bytes(text.replace(",", ".").encode("utf-8-sig"))
    assert load_case(tmp_path / "a.toml").surface.shape == "sphere"


def test_a_file_can_be_smoothed_by_harmonics(folder):
    """A noisy ball: the start of the run is a ball, and the summary says what was done."""
    x, faces = ball(2)
    noise = 1 + 0.05 * np.random.default_rng(0).uniform(-1, 1, (len(x), 1))
    (folder / "noisy.obj").write_text(obj_text(x * noise, faces))
    text = '[surface]\nfile = "noisy.obj"\nsmooth = "harmonics"\nlevel = 1\n[time]\nt1 = 1.0\n'
    (folder / "case.toml").write_text(text)
    start = starting_surface(load_case(folder / "case.toml"))
    nodes = np.asarray(start.x)
    r = np.linalg.norm(nodes - nodes.mean(axis=0), axis=1)
    assert np.ptp(r) < 0.03 and start.mesh.n_nodes == 162
    (act,) = start.repairs
    assert act.startswith("smoothed by spherical harmonics of degree")
    with pytest.raises(CaseError, match="is for meshes from a file"):
        load_case('[surface]\nshape = "torus"\nsmooth = "harmonics"\n[time]\nt1 = 1.0\n')


ROUGH = np.random.default_rng(0).normal(scale=0.02, size=(336, 3))


@pytest.fixture
def rough_torus(folder):
    """A torus with noise in a file: handles are no matter of harmonics."""
    mesh, x = torus(2.0, 1.0, level=2, degree=1)
    (folder / "torus.obj").write_text(obj_text(np.asarray(x) + ROUGH, np.asarray(mesh.triangles)))
    return folder


def test_a_file_with_a_handle_can_be_smoothed_by_fairing(rough_torus):
    text = '[surface]\nfile = "torus.obj"\nsmooth = "fairing"\nwavelength = 2.4\n[time]\nt1 = 1.0\n'
    (rough_torus / "case.toml").write_text(text)
    case = load_case(rough_torus / "case.toml")
    assert load_case(case.to_toml()) == case and case.surface.level == 0
    start = starting_surface(case)
    assert start.mesh.genus == 1 and start.mesh.degree == 2
    (act,) = start.repairs
    assert act.startswith("smoothed by fairing, waves of 2.4 halved")
    energy = float(Willmore()(start.mesh, start.x))
    assert energy == pytest.approx(8 * np.pi**2 / np.sqrt(3), rel=0.03)  # R = 2 r


@pytest.mark.parametrize(
    "keys, words",
    [
        ('smooth = "harmonics"', r"\[surface\] smooth.*genus 0.*fairing"),
        ('smooth = "fairing"\nwavelength = 0.1', r"\[surface\] wavelength.*at least"),
        ('smooth = "fairing"\nwavelength = 9.0', r"\[surface\] wavelength.*too long"),
    ],
)
def test_a_smoothing_that_fails_names_its_key(rough_torus, keys, words):
    text = f'[surface]\nfile = "{rough_torus}/torus.obj"\n{keys}\n[time]\nt1 = 1.0\n'
    with pytest.raises(CaseError, match=f"(?s){words}"):
        starting_surface(load_case(text))


@pytest.mark.parametrize(
    "keys, words",
    [
        ('smooth = "taubin"', r"\[surface\] smooth.*harmonics.*fairing"),
        ("wavelength = 1.0", r"\[surface\] wavelength.*fairing"),
        ('smooth = "harmonics"\nwavelength = 1.0', r"\[surface\] wavelength.*fairing"),
        ('smooth = "fairing"\nwavelength = 0.0', r"\[surface\] wavelength.*> 0"),
        ('smooth = "fairing"\ncomponents = 2', r"\[surface\] smooth.*one piece"),
    ],
)
def test_keys_of_smoothing_are_checked(keys, words):
    with pytest.raises(CaseError, match=f"(?s){words}"):
        load_case(f'[surface]\nfile = "a.obj"\n{keys}\n[time]\nt1 = 1.0\n')


def test_a_rough_surface_is_told_what_to_do(tmp_path):
    """At the defaults of a run: both ways to smooth, and degree 1."""
    x, faces = ball(3)
    noise = 1 + np.random.default_rng(0).normal(scale=0.02, size=(len(x), 1))
    (tmp_path / "ball.obj").write_text(obj_text(x * noise, faces))
    text = f'[surface]\nfile = "{tmp_path}/ball.obj"\n[time]\nt1 = 1.0\n'
    with pytest.warns(SurfaceWarning) as said:
        starting_surface(load_case(text))
    (words,) = (str(w.message) for w in said if "is noise" in str(w.message))
    for way in ('smooth = "harmonics"', '"fairing"', "`surface.smoothed`", "degree 1"):
        assert way in words

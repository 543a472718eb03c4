"""The command line: what it prints, where, and its exit status."""

import json
import os
import pathlib
import signal
import subprocess
import sys

import pytest

from jaxwillmore import _machine
from jaxwillmore._version import __version__
from jaxwillmore.cases import example_names
from jaxwillmore.cli import main
from jaxwillmore.io import write_ply
from jaxwillmore.mesh import icosphere
from jaxwillmore.shapes import SHAPES

ROOT = pathlib.Path(__file__).parents[1]
CASE = """
[surface]
shape = "ellipsoid"
semi_axes = [1.0, 1.0, 1.3]
level = 1
degree = 1
[flow]
tangential = "none"
[time]
t1 = 0.01
dt0 = 1e-3
[output]
every = 0.01
picture = false
"""


@pytest.fixture
def case(tmp_path):
    """A case file that runs in seconds."""
    path = tmp_path / "case.toml"
    path.write_text(CASE, encoding="utf-8")
    return str(path)


def jaxwillmore(*arguments, **options):
    """The command in a process of its own."""
    command = [sys.executable, "-m", "jaxwillmore", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, **options)


def assert_one_clear_line(error, *words):
    """One line on stderr that starts with the name of the program and holds the words."""
    assert error.startswith("jaxwillmore: ") and error.count("\n") == 1, error
    assert "Traceback" not in error
    for word in words:
        assert word in error, error


# 1. Without a run.


def test_version_and_help_in_a_process_of_their_own():
    version = jaxwillmore("--version")
    assert (version.returncode, version.stdout) == (0, f"jaxwillmore {__version__}\n")
    for arguments in (["--help"], ["run", "--help"], ["check", "--help"]):
        answer = jaxwillmore(*arguments)
        assert answer.returncode == 0 and "usage: jaxwillmore" in answer.stdout
        assert answer.stderr == ""


def test_help_names_every_command(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    words = (
        "run",
        "equilibrium",
        "branch",
        "check",
        "shapes",
        "verify",
        "Exit status",
        "--version",
    )
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    "arguments",
    [[], ["walk"], ["run"], ["run", "a.toml"], ["check"], ["branch"], ["equilibrium"], ["verify"]],
)
def test_a_wrong_command_line_ends_with_2(capsys, arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: jaxwillmore" in capsys.readouterr().err


def test_shapes_lists_every_shape_with_its_parameters(capsys):
    assert main(["shapes"]) == 0
    text = capsys.readouterr().out
    for name, spec in SHAPES.items():
        assert f"{name}: " in text
        for parameter in spec.parameters:
            assert f"    {parameter} = " in text
    assert "level" in text and "degree" in text


# 2. Checking a mesh.


def test_a_sound_mesh_is_reported_and_ends_with_0(tmp_path, capsys):
    write_ply(tmp_path / "ball.ply", *icosphere(1, degree=1))
    assert main(["check", str(tmp_path / "ball.ply")]) == 0
    out, err = capsys.readouterr()
    assert "No defects found" in out and "genus 0" in out and "chunkiness" in out
    assert err == ""


def test_the_example_mesh_is_sound(capsys):
    assert main(["check", "example:red_blood_cell.npz"]) == 0
    assert "2183 vertices" in capsys.readouterr().out


def test_an_open_mesh_is_named_and_ends_with_1(tmp_path, capsys):
    path = tmp_path / "open.off"
    path.write_text("OFF\n4 3 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n")
    assert main(["check", str(path)]) == 1
    out, err = capsys.readouterr()
    assert "open" in out and "open.off" in out and err == ""


def test_a_file_that_is_no_mesh_ends_with_1(tmp_path, capsys):
    (tmp_path / "noise.ply").write_bytes(bytes(range(256)))
    assert main(["check", str(tmp_path / "noise.ply")]) == 1
    assert "noise.ply" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["none.ply", "", "example:none.npz"])
def test_a_mesh_that_is_not_there_ends_with_2(tmp_path, capsys, name):
    path = name if name.startswith("example:") else str(tmp_path / name)
    assert main(["check", path]) == 2
    assert_one_clear_line(capsys.readouterr().err, name.removeprefix("example:"))


# 3. Running a case.


def test_a_run_prints_its_progress_and_its_end(case, tmp_path, capsys):
    assert main(["run", case, "--out", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    assert err == "" and "\r" not in out
    lines = out.splitlines()
    assert lines[1].startswith("preparing") and lines[2].startswith("step     1 ")
    assert lines[0] == "42 nodes of degree 1; about 0.6 GB of memory"
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert f"reached_t1 at t = 0.01 after {summary['steps']} steps" in out
    assert f"{summary['willmore']:.8g}" in out and str(tmp_path / "out") in lines[-1]


def test_a_quiet_run_prints_nothing(case, tmp_path, capsys):
    assert main(["run", case, "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (tmp_path / "out" / "summary.json").is_file()


def test_an_earlier_run_is_replaced_only_on_request(case, tmp_path, capsys):
    arguments = ["run", case, "--out", str(tmp_path / "out"), "--quiet"]
    assert main(arguments) == 0
    assert main(arguments) == 2
    assert_one_clear_line(capsys.readouterr().err, "out", "earlier run", "--replace")
    assert main([*arguments, "--replace"]) == 0


@pytest.mark.parametrize("command", ["run", "equilibrium"])
def test_a_case_larger_than_the_machine_is_refused_before_it_starts(
    command, case, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(_machine, "machine_memory", lambda: 10**8)
    with open(case, "a", encoding="utf-8") as file:
        file.write('[constraints]\narea = "initial"\n')
    assert main([command, case, "--out", str(tmp_path / "out"), "--quiet"]) == 2
    words = "[surface]", "42 nodes", "about 0.6 GB", "this machine has 0.1 GB", "coarser mesh"
    assert_one_clear_line(capsys.readouterr().err, *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_terminal_gets_one_line_that_is_rewritten(case, tmp_path):
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "jaxwillmore", "run", case, "--out", str(tmp_path / "out")]
    with subprocess.Popen(command, cwd=ROOT, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        text = b""
        while True:
            try:
                chunk = os.read(ours, 10_000)
            except OSError:  # the other end is closed
                chunk = b""
            if not chunk:
                break
            text += chunk
    os.close(ours)
    assert process.returncode == 0, text
    progress = text.decode().split("reached_t1")[0]
    size, progress = progress.split("of memory")
    assert "42 nodes" in size and progress.count("\rstep") >= 1
    assert progress.count("\n") == 2  # after the size, and at the end


def test_a_wrong_case_ends_with_2(case, tmp_path, capsys):
    wrong = tmp_path / "wrong.toml"
    for old, new, *words in [
        ("t1 = 0.01", "t1 = nan", "[time] t1", "finite"),
        ("t1 = 0.01", "", "[time] t1", "missing"),
        ("every", "evry", "[output] evry", "`every`"),
        ("1.3]", "-1.3]", "semi_axes", "positive"),
        ("[time]", "[time", "TOML", "line"),
    ]:
        wrong.write_text(CASE.replace(old, new), encoding="utf-8")
        assert main(["run", str(wrong), "--out", str(tmp_path / "out")]) == 2
        assert_one_clear_line(capsys.readouterr().err, *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["none.toml", "example:none"])
def test_a_case_that_is_not_there_ends_with_2(tmp_path, capsys, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert main(["run", name, "--out", "out"]) == 2
    words = example_names() if name.startswith("example:") else ["No such file"]
    assert_one_clear_line(capsys.readouterr().err, *words)


def test_a_missing_mesh_ends_with_2_and_a_broken_one_with_1(tmp_path, capsys):
    for mesh, status in {"none.ply": 2, "broken.off": 1}.items():
        (tmp_path / "broken.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
        (tmp_path / "c.toml").write_text(f"[surface]\nfile = '{mesh}'\n[time]\nt1 = 1.0\n")
        assert main(["run", str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == status
        error = capsys.readouterr().err
        assert error.startswith("jaxwillmore: ") and mesh in error and "Traceback" not in error


def test_a_place_that_cannot_be_written_ends_with_2(case, tmp_path, capsys):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    assert main(["run", case, "--out", str(tmp_path / "file" / "out"), "--quiet"]) == 2
    assert_one_clear_line(capsys.readouterr().err, "file")


def test_a_failed_run_ends_with_1_and_says_why(case, tmp_path, capsys):
    path = tmp_path / "short.toml"
    path.write_text(CASE.replace("dt0 = 1e-3", "dt0 = 1e-3\nmax_steps = 1"), encoding="utf-8")
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 1
    assert_one_clear_line(capsys.readouterr().err, "max_steps")
    assert (tmp_path / "out" / "final.npz").is_file()


def test_warnings_are_plain_lines(tmp_path, capsys):
    text = CASE.replace("[flow]", "[flow]\nbdf_order = 5")
    text = text.replace("[time]", "[time]\nmax_steps = 1")
    (tmp_path / "fifth.toml").write_text(text, encoding="utf-8")
    assert main(["run", str(tmp_path / "fifth.toml"), "--out", str(tmp_path / "out")]) == 1
    warning = capsys.readouterr().err.splitlines()[0]
    assert warning.startswith("jaxwillmore: warning: BDF5")


def interrupted_summary(command, out, number, word):
    """Send a signal at the first line that starts with `word`; check the end; the summary."""
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "jaxwillmore", *command, "--out", str(out)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            if line.startswith(word):
                process.send_signal(number)
                break
        process.stdout.read()
        error = process.stderr.read()
    assert process.returncode == (130 if number == signal.SIGINT else 143)
    assert_one_clear_line(error, "interrupted")
    assert not (out / ".lock").exists()
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["status"] == "interrupted"
    return summary


def test_a_run_ended_by_a_signal_says_so_by_its_status_and_is_complete(tmp_path):
    text = CASE.replace("t1 = 0.01", "t1 = 1e4\nstop_when_stationary = 0.0\nrtol = 1e-7")
    (tmp_path / "long.toml").write_text(text.replace("0.01", "1e3"), encoding="utf-8")
    command = ["run", str(tmp_path / "long.toml")]
    summary = interrupted_summary(command, tmp_path / "out", signal.SIGTERM, "step")
    assert summary["steps"] >= 1


# 4. Verification.


@pytest.fixture
def study(monkeypatch):
    """The command with a study of three rows in place of the real one, which takes a minute."""
    from jaxwillmore import verify

    row = {"surface": "torus", "energy": "tension", "direction": "normal", "exact": 1.0}
    derivatives = [row | {"h": 0.4, "error": 1e-2}, row | {"h": 0.1, "error": 1e-5}]
    identities = [{"surface": "torus", "identity": "exact", "error": 1e-15}]
    tables = verify.ShapeStudy(derivatives, identities, [{"mode": 2, "h": 0.1, "error": 1e-4}])
    monkeypatch.setattr(verify, "shape_study", lambda levels, progress: tables)
    return tables


def test_verify_prints_its_tables_and_leaves_them(study, tmp_path, capsys):
    folder = tmp_path / "out"
    assert main(["verify", "shape-derivative", "--out", str(folder)]) == 0
    text = capsys.readouterr().out
    assert "1.0e-02  1.0e-05" in text and "Everything holds." in text
    names = {path.name for path in folder.iterdir()}
    assert names >= {"derivatives.csv", "identities.csv", "second_variations.csv"}


def test_verify_ends_with_1_and_says_what_fails(study, capsys):
    study.derivatives[1]["error"] = 1e-2
    assert main(["verify", "shape-derivative", "--levels", "1"]) == 1
    out, err = capsys.readouterr()
    assert "NOT everything holds." in out
    assert "torus, tension, normal: the error 1.00e-02 is above 3e-04" in err


@pytest.mark.parametrize("levels", [["0"], ["9"], ["one"], []])
def test_verify_refuses_levels_out_of_range(levels):
    with pytest.raises(SystemExit) as caught:
        main(["verify", "shape-derivative", "--levels", *levels])
    assert caught.value.code == 2


# 5. Equilibria and branches.

VESICLE = """
[surface]
shape = "ellipsoid"
semi_axes = [1.0, 1.0, 2.0]
level = 1
[constraints]
area = "initial"
reduced_volume = 0.8
[branch]
stop = 0.79
step0 = 0.02
[output]
picture = false
"""


@pytest.mark.slow
def test_an_equilibrium_and_its_branch_print_their_progress_and_their_end(tmp_path, capsys):
    (tmp_path / "case.toml").write_text(VESICLE, encoding="utf-8")
    lines = {}
    for command in ("equilibrium", "branch"):
        out = str(tmp_path / command)
        assert main([command, str(tmp_path / "case.toml"), "--out", out]) == 0
        text, err = capsys.readouterr()
        assert err == ""
        lines[command] = text.splitlines()
        assert lines[command][0].startswith("preparing") and out in lines[command][-1]
    assert any(line.startswith("converged after") for line in lines["equilibrium"])
    assert any("0 negative directions" in line for line in lines["equilibrium"])
    end = next(line for line in lines["branch"] if line.startswith("end_reached"))
    assert "reduced_volume = 0.79 after 2 points" in end


@pytest.mark.slow
@pytest.mark.parametrize(
    "command, number", [("equilibrium", signal.SIGINT), ("branch", signal.SIGTERM)]
)
def test_a_search_interrupted_at_once_keeps_its_start(tmp_path, command, number):
    """The signal comes before the first step, which takes a while to compile."""
    (tmp_path / "case.toml").write_text(VESICLE, encoding="utf-8")
    arguments = [command, str(tmp_path / "case.toml")]
    summary = interrupted_summary(arguments, tmp_path / "out", number, "preparing")
    assert summary["willmore"] == pytest.approx(summary["start"]["willmore"], rel=1e-6)
    assert (tmp_path / "out" / "final.npz").is_file()


def test_a_case_without_its_section_ends_with_2(case, tmp_path, capsys):
    assert main(["branch", case, "--out", str(tmp_path / "out")]) == 2
    assert_one_clear_line(capsys.readouterr().err, "[branch] is missing")


def test_doctor_says_what_is_there(capsys):
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    for words in (
        "64-bit floats        on",
        "device",
        "compiled programs",
        "first step",
        "ms each",
    ):
        assert words in said

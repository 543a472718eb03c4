"""Manners of the command: it starts at once, answers signals, and does not need to be heard."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from jaxwillmore.cli import main
from jaxwillmore.io import read_history

ROOT = pathlib.Path(__file__).parents[1]
COMMAND = [sys.executable, "-m", "jaxwillmore"]
CASE = """
[surface]
shape = "sphere"
level = 1
degree = 1
[flow]
kind = "mean-curvature"
tangential = "none"
[time]
t1 = 1.0
max_steps = 3
[output]
frames = false
picture = false
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The folder in which the runs below keep what one of them has compiled."""
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture
def run(tmp_path, compiled, monkeypatch):
    """A run of three steps, then its limit: exit status 1, and everything is written."""
    monkeypatch.setenv("JAXWILLMORE_CACHE", str(compiled))
    (tmp_path / "case.toml").write_text(CASE, encoding="utf-8")
    return [*COMMAND, "run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "out")]


def assert_complete(out):
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert (summary["status"], summary["steps"]) == ("step_limit", 3)
    assert [row["step"] for row in read_history(out / "history.csv")] == [0, 1, 2, 3]
    assert (out / "final.npz").is_file() and not (out / ".lock").exists()


# 1. The start.


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["run", "--help"], ["walk"]])
def test_what_computes_nothing_does_not_import_jax(arguments):
    program = (
        "import sys\n"
        "from jaxwillmore.cli import main\n"
        "try:\n"
        "    main(sys.argv[1:])\n"
        "except SystemExit:\n"
        "    assert not {'jax', 'numpy', 'scipy'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, *arguments], cwd=ROOT)
    assert done.returncode == 0


@pytest.mark.parametrize("first", ["jax", "jaxwillmore"])
def test_floats_have_64_bits_whichever_is_imported_first(first):
    program = f"import {first}, jaxwillmore, jax.numpy\nassert jax.numpy.ones(1).dtype == 'float64'"
    environment = os.environ | {"JAX_ENABLE_X64": "0"}
    assert subprocess.run([sys.executable, "-c", program], env=environment).returncode == 0


@pytest.mark.parametrize("name", ["", " "])
@pytest.mark.parametrize("command", [["run", "a"], ["fit", "a"], ["verify", "shape-derivative"]])
def test_an_empty_name_of_a_folder_is_refused(command, name, capsys):
    with pytest.raises(SystemExit) as caught:
        main([*command, "--out", name])
    assert caught.value.code == 2
    assert "--out: needs the name of a folder" in capsys.readouterr().err


# 2. Signals.


def catches_sigterm(process):
    """Whether the process has a handler for SIGTERM; that of SIGINT is Python's at first."""
    with open(f"/proc/{process.pid}/status") as file:
        caught = next(line for line in file if line.startswith("SigCgt"))
    return int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="handlers are listed in /proc")
@pytest.mark.parametrize("name, status", [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 143)])
def test_a_signal_during_imports_ends_the_command_at_once_in_one_line(name, status):
    """It comes while JAX is imported, where an exception may be lost in a callback."""
    number = getattr(signal, name)
    # What a test in the background ignores the command would ignore, too.
    before = signal.getsignal(number)
    if before == signal.SIG_IGN:
        signal.signal(number, signal.SIG_DFL)
    command = [*COMMAND, "check", "example:red_blood_cell.npz"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, **pipes) as process:
        signal.signal(number, before)
        while not catches_sigterm(process):
            time.sleep(0.001)
        time.sleep(0.2)
        process.send_signal(number)
        out, error = process.communicate()
    assert process.returncode == status and out == b""
    assert error.startswith(b"jaxwillmore: ") and error.count(b"\n") == 1


# 3. Nobody listens.


def test_a_run_goes_on_when_the_reader_of_its_output_goes_away(run, tmp_path):
    with subprocess.Popen(
        run, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert "42 nodes" in process.stdout.readline()
        process.stdout.close()
        error = process.stderr.read()
    assert process.returncode == 1 and error.count("\n") == 1 and "max_steps" in error
    assert_complete(tmp_path / "out")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a disk that is always full")
def test_a_run_goes_on_when_the_disk_of_its_log_is_full(run, tmp_path):
    with open("/dev/full", "w") as full:
        assert subprocess.run(run, cwd=ROOT, stdout=full, stderr=full).returncode == 1
    assert_complete(tmp_path / "out")


@pytest.mark.skipif(os.name == "nt", reason="written for a POSIX shell")
def test_a_run_goes_on_without_standard_streams(run, tmp_path):
    """Its files do not take their numbers, to which everything below Python prints."""
    done = subprocess.run(["sh", "-c", '"$@" <&- >&- 2>&-', "sh", *run], cwd=ROOT)
    assert done.returncode == 1
    assert_complete(tmp_path / "out")

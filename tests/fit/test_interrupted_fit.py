"""A fit that is interrupted from outside keeps its last iterate, says so, and goes on from it."""

import json
import pathlib
import signal
import subprocess
import sys

import pytest

from jaxwillmore.cli import main
from jaxwillmore.io import write_npz
from jaxwillmore.mesh import ellipsoid

from .profiles import OBLATE, equilibrium_nodes

ROOT = pathlib.Path(__file__).parents[2]

MATCH = """
[target]
file = "cell.npz"
[model]
kind = "oblate"
level = 1
reduced_volume = 0.75
[fit]
free = ["reduced_volume"]
picture = false
"""

SERIES = """
[target]
file = ["cell.npz", "later.npz"]
times = [0.0, 0.01]
[flow]
tangential = "none"
[fit]
method = "series"
rtol = 1e-3
picture = false
"""


@pytest.mark.slow
@pytest.mark.parametrize(("case", "number"), [(MATCH, signal.SIGTERM), (SERIES, signal.SIGINT)])
def test_a_signal_ends_a_fit_after_its_step_and_it_resumes(tmp_path, capsys, case, number):
    if case == MATCH:
        write_npz(tmp_path / "cell.npz", *equilibrium_nodes(*OBLATE, level=1))
    else:
        # Nothing flows from the one to the other: what matters is that there is a way to go.
        write_npz(tmp_path / "cell.npz", *ellipsoid((1.0, 1.2, 1.5), 0, 2))
        write_npz(tmp_path / "later.npz", *ellipsoid((1.1, 1.2, 1.4), 0, 2))
    (tmp_path / "fit.toml").write_text(case)
    command = ["fit", str(tmp_path / "fit.toml"), "--out", str(tmp_path / "out")]
    start = [sys.executable, "-m", "jaxwillmore", *command]
    with subprocess.Popen(start, cwd=ROOT, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline().startswith("step   0")
        child.send_signal(number)
        steps = [line for line in child.stdout if line.startswith("step")]
        assert child.wait(timeout=300) == 128 + number
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["status"] == "interrupted" and len(steps) <= 2
    iterate = json.loads((tmp_path / "out" / "iterate.json").read_text())["parameters"]
    (name,) = summary["free"]
    last = iterate[0][name] if case == MATCH else iterate[name]
    (tmp_path / "fit.toml").write_text(case + "max_steps = 1\n")
    main([*command, "--resume"])
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("step   0") and f"{name} {last:.6g}" in first

"""The folder of a run can be moved, renamed and copied, and its case still runs."""

import numpy as np
import pytest

from jaxwillmore.cases import load_case, load_fit
from jaxwillmore.io import write_npz, write_ply
from jaxwillmore.mesh import icosphere
from jaxwillmore.runs import run_case
from jaxwillmore.runs._inputs import stored_case, stored_fit
from jaxwillmore.runs._start import starting_surface

CASE = """
[surface]
file = "meshes/ball.ply"
degree = 1
[flow]
kind = "phase"
[phase]
line_tension = 1.0
interface_width = 0.6
[time]
t1 = 0.002
dt0 = 1e-3
[output]
picture = false
"""


def test_a_moved_folder_runs_again_without_its_origin(tmp_path):
    home = tmp_path / "home"
    (home / "meshes").mkdir(parents=True)
    write_ply(home / "meshes" / "ball.ply", *icosphere(1, degree=1))
    (home / "mine.toml").write_text(CASE)
    first = run_case(load_case(home / "mine.toml"), home / "out")
    for path in first.folder.rglob("*"):
        assert path.is_dir() or str(tmp_path).encode() not in path.read_bytes(), path
    first.folder.rename(tmp_path / "moved")
    (home / "meshes" / "ball.ply").unlink()
    case = load_case(tmp_path / "moved" / "case.toml")
    # In its own place: the files that it reads are among those that are replaced.
    again = run_case(case, tmp_path / "moved", existing="replace")
    assert again.summary["willmore"] == first.summary["willmore"]
    assert load_case(tmp_path / "moved" / "case.toml") == case


def test_two_files_of_one_name_and_an_odd_one_are_kept_apart(tmp_path):
    targets = []
    for place, radius in (("a/ball.npz", 1.0), ("b/ball.npz", 2.0), ("bälle 3.npz", 3.0)):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        write_npz(tmp_path / place, *icosphere(0, degree=1, radius=radius))
        targets.append(place)
    (tmp_path / "fit.toml").write_text(
        f"[target]\nfile = {targets + ['example:keratocyte_675.npz']}", encoding="utf-8"
    )
    task = load_fit(tmp_path / "fit.toml")
    stored = stored_fit(task)
    assert list(stored.files) == ["ball.npz", "input_1.npz", "input_2.npz"]
    names = [*(f"inputs/{name}" for name in stored.files), "example:keratocyte_675.npz"]
    assert load_fit({"target": {"file": names}}).target == load_fit(stored.text).target
    for place, data in zip(targets, stored.files.values(), strict=True):
        assert data == (tmp_path / place).read_bytes()


def test_a_concentration_is_kept_beside_its_surface(tmp_path):
    np.save(tmp_path / "c.npy", np.full(162, 0.3))
    text = "[surface]\nshape = 'sphere'\nlevel = 1\n[flow]\nkind = 'phase'\n[phase]\n"
    text += "line_tension = 1.0\ninterface_width = 0.5\nstart = 'file'\nfile = 'c.npy'\n"
    (tmp_path / "case.toml").write_text(text + "[time]\nt1 = 1.0\n")
    stored = stored_case(load_case(tmp_path / "case.toml"))
    assert list(stored.files) == ["c.npy"] and 'file = "inputs/c.npy"' in stored.text
    (tmp_path / "new" / "inputs").mkdir(parents=True)
    (tmp_path / "new" / "case.toml").write_text(stored.text, encoding="utf-8")
    (tmp_path / "c.npy").rename(tmp_path / "new" / "inputs" / "c.npy")
    start = starting_surface(load_case(tmp_path / "new" / "case.toml"))
    np.testing.assert_array_equal(start.initial["c"], 0.3)


def test_a_file_that_is_gone_is_named(tmp_path):
    write_npz(tmp_path / "ball.npz", *icosphere(0, degree=1))
    case = load_case({"surface": {"file": str(tmp_path / "ball.npz")}, "time": {"t1": 1.0}})
    (tmp_path / "ball.npz").unlink()
    with pytest.raises(FileNotFoundError, match="ball.npz"):
        stored_case(case)

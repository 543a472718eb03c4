"""The folder of a run: complete at every moment, never shared, never silently overwritten."""

import json
import math
import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.io import RunFolder, RunFolderError, read_history, read_surface
from jaxwillmore.mesh import icosphere

MESH, X = icosphere(1, degree=2)


def fill(folder, times=(0.0, 0.5)):
    folder.write_text("case.toml", "[surface]\n")
    for t in times:
        folder.write_frame(t, MESH, X, {"H": 2 + 0 * X[:, 0]})
        folder.append_history({"t": t, "energy": 8 * math.pi})
    folder.write_final(MESH, X, {"H": 2 + 0 * X[:, 0]})
    folder.write_summary({"status": "reached_t1"})


def test_a_run_leaves_everything_readable(tmp_path):
    with RunFolder(tmp_path / "out") as folder:
        fill(folder)
    names = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*")}
    assert names == {
        "case.toml", "frames", "frames/frame_000000.vtu", "frames/frame_000001.vtu", "run.pvd",
        "history.csv", "final.npz", "final.ply", "summary.json",
    }  # fmt: skip
    assert [r["t"] for r in read_history(tmp_path / "out" / "history.csv")] == [0.0, 0.5]
    assert read_surface(tmp_path / "out" / "final.npz")[0].degree == 2
    assert read_surface(tmp_path / "out" / "final.ply")[0].n_cells == 4 * MESH.n_cells
    entries = [(0.0, "frames/frame_000000.vtu"), (0.5, "frames/frame_000001.vtu")]
    assert folder.series.entries() == entries


def test_summary_is_strict_json(tmp_path):
    with RunFolder(tmp_path) as folder:
        folder.write_summary(
            {
                "t": jnp.asarray(0.1),
                "bad": math.nan,
                "list": [np.float64(1 / 3), np.int64(2), math.inf],
                "deep": {"array": np.arange(3), "path": tmp_path, "none": None, "ν": True},
            }
        )
        with pytest.raises(TypeError, match="function"):
            folder.write_summary({"f": math.sin, "g": fill})

    def refuse(word):
        raise AssertionError(word)

    text = (tmp_path / "summary.json").read_text()
    assert json.loads(text, parse_constant=refuse) == {
        "t": 0.1,
        "bad": None,
        "list": [1 / 3, 2, None],
        "deep": {"array": [0, 1, 2], "path": str(tmp_path), "none": None, "ν": True},
    }


def test_an_earlier_run_is_not_overwritten_unasked(tmp_path):
    with RunFolder(tmp_path) as folder:
        fill(folder)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RunFolderError, match="earlier run"):
        RunFolder(tmp_path)
    with RunFolder(tmp_path, existing="resume") as folder:
        folder.keep_until(0.0)
        folder.append_history({"t": 0.25, "energy": 1.0})
        folder.write_frame(0.25, MESH, X)
    assert [r["t"] for r in read_history(tmp_path / "history.csv")] == [0.0, 0.25]
    assert [t for t, _ in folder.series.entries()] == [0.0, 0.25]
    with RunFolder(tmp_path, existing="replace"):
        assert sorted(p.name for p in tmp_path.iterdir()) == [".lock", "frames", "notes.txt"]


def test_unusable_folders(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunFolderError, match="is a file"):
        RunFolder(tmp_path / "file")
    with pytest.raises(RunFolderError, match="parent .*no.* does not exist"):
        RunFolder(tmp_path / "no" / "out")
    with pytest.raises(RunFolderError, match="cannot make"):
        RunFolder(tmp_path / ("n" * 300))
    with pytest.raises(RunFolderError):
        RunFolder(tmp_path / "file" / "out")
    with RunFolder(tmp_path / "наблюдения ½∫H²") as folder:
        fill(folder)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes anywhere")
def test_a_read_only_folder_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(RunFolderError, match="[Pp]ermission"):
        RunFolder(tmp_path)


def test_names_stay_inside_the_folder(tmp_path):
    with RunFolder(tmp_path / "out") as folder:
        for name in ("../evil", "a/b", ".hidden", "-rf", "", "a" * 65, "a\n", "ü"):
            with pytest.raises(ValueError, match="named with"):
                folder.write_text(name, "")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.skipif(os.name == "nt", reason="locks are POSIX")
def test_two_runs_cannot_share_a_folder(tmp_path):
    with RunFolder(tmp_path) as folder:
        with pytest.raises(RunFolderError, match=f"in use by process {os.getpid()} on"):
            RunFolder(tmp_path)
    folder.close()  # a second time does nothing
    RunFolder(tmp_path).close()
    assert not (tmp_path / ".lock").exists()


@pytest.mark.skipif(os.name == "nt", reason="locks are POSIX")
def test_the_lock_of_a_killed_run_is_taken_over(tmp_path):
    """A child holds the lock and is killed; its lock file and half a file stay behind."""
    from jaxwillmore.io import _lock

    program = (
        "import pathlib, runpy, sys, time\n"
        "lock = runpy.run_path(sys.argv[1])['FolderLock'](pathlib.Path(sys.argv[2]))\n"
        "print('locked', flush=True)\n"
        "time.sleep(60)\n"
    )
    command = [sys.executable, "-c", program, _lock.__file__, str(tmp_path / ".lock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None and child.stdout.readline() == b"locked\n"
        with pytest.raises(RunFolderError, match=f"process {child.pid} on"):
            RunFolder(tmp_path)
        child.kill()
        child.wait()
    (tmp_path / ".jaxwillmore-1-ab.tmp").write_text("half")
    assert (tmp_path / ".lock").exists()
    with RunFolder(tmp_path) as folder:
        fill(folder)
    assert not list(tmp_path.glob(".*"))

"""The folder of a run: complete at every moment, never shared, never silently overwritten."""

import errno
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
        ".files", "case.toml", "frames", "frames/frame_000000.vtu", "frames/frame_000001.vtu",
        "run.pvd", "history.csv", "final.npz", "final.ply", "summary.json",
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
        folder.keep(1, 1)
        left = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()}
        assert left == {
            *(".files", ".lock", "notes.txt", "case.toml", "history.csv", "run.pvd"),
            "frames/frame_000000.vtu",
        }
        with pytest.raises(RunFolderError, match="holds 1 rows; 2 were written"):
            folder.keep(1, 2)
        folder.append_history({"t": 0.25, "energy": 1.0})
        folder.write_frame(0.25, MESH, X)
    assert [r["t"] for r in read_history(tmp_path / "history.csv")] == [0.0, 0.25]
    assert [t for t, _ in folder.series.entries()] == [0.0, 0.25]
    with RunFolder(tmp_path, existing="replace"):
        left = sorted(p.name for p in tmp_path.iterdir())
        assert left == [".files", ".lock", "frames", "notes.txt"]
        assert not list((tmp_path / "frames").iterdir())


FOREIGN = [
    "final.docx", "final.blend", "case.toml", "profile.png", "summary.json", "overlay_mine.png",
    "frames/frame_mine.vtu", "inputs/mine.ply",
]  # fmt: skip


@pytest.mark.parametrize("existing", ["refuse", "replace", "resume"])
@pytest.mark.parametrize("name", FOREIGN)
def test_what_no_run_wrote_is_refused_by_name_and_stays(tmp_path, name, existing):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    with pytest.raises(RunFolderError, match=f"no run wrote.*`{name}`.*Move them away"):
        RunFolder(tmp_path, existing)
    left = [p for p in tmp_path.rglob("*") if p.is_file() and p.name != ".files"]
    assert left == [tmp_path / name] and left[0].read_text() == "mine"


@pytest.mark.parametrize("name", ["case.toml", "summary.json"])
def test_a_text_that_was_changed_since_is_not_removed(tmp_path, name):
    with RunFolder(tmp_path) as folder:
        fill(folder)
    with open(tmp_path / name, "a") as file:
        file.write("# mine\n")
    with pytest.raises(RunFolderError, match=f"as they are: `{name}`"):
        RunFolder(tmp_path, "replace")
    assert (tmp_path / "final.npz").exists()


def test_a_file_that_appears_during_a_run_is_not_written_over(tmp_path):
    with RunFolder(tmp_path) as folder:
        (tmp_path / "final.npz").write_text("mine")
        with pytest.raises(RunFolderError, match="final.npz"):
            folder.write_final(MESH, X)
    assert (tmp_path / "final.npz").read_text() == "mine"


def test_the_list_of_files_names_nothing_outside_the_folder(tmp_path):
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "out").mkdir()
    for line in ("../precious", "frames/../../precious", str(tmp_path / "precious"), "\0"):
        (tmp_path / "out" / ".files").write_text(f"{line}\n")
        with pytest.raises(RunFolderError, match="not a list of the files"):
            RunFolder(tmp_path / "out", "replace")
    assert (tmp_path / "precious").read_text() == "mine"


def test_a_killed_run_leaves_a_list_that_can_be_read(tmp_path):
    """A line that was cut short is of a file that was not begun."""
    with RunFolder(tmp_path) as folder:
        fill(folder)
    with open(tmp_path / ".files", "a") as file:
        file.write("frames/fra")
    with RunFolder(tmp_path, "replace") as folder:
        assert not (tmp_path / "final.npz").exists()
        fill(folder)


def test_the_summary_goes_first_when_a_run_is_replaced(tmp_path, monkeypatch):
    with RunFolder(tmp_path) as folder:
        fill(folder)
    gone = []
    monkeypatch.setattr(type(tmp_path), "unlink", lambda path, **_: gone.append(path.name))
    with RunFolder(tmp_path, "replace"):
        assert gone[0] == "summary.json" and "final.npz" in gone


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
@pytest.mark.parametrize(
    "name", [".lock", ".files", "history.csv", "frames", "shapes", "inputs", "final.npz"]
)
def test_symbolic_links_are_refused_and_what_they_point_to_stays(tmp_path, name):
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    with RunFolder(out) as folder:
        fill(folder)
    elsewhere.mkdir()
    (elsewhere / "frame_000000.vtu").write_text("mine")
    (tmp_path / "precious").write_text("mine")
    (out / name).rename(tmp_path / "moved") if (out / name).exists() else None
    (out / name).symlink_to(elsewhere if "." not in name else tmp_path / "precious")
    for existing in ("refuse", "replace", "resume"):
        with pytest.raises(RunFolderError, match=rf"{name}.*symbolic link"):
            RunFolder(out, existing)
    assert (elsewhere / "frame_000000.vtu").read_text() == "mine"
    assert (tmp_path / "precious").read_text() == "mine" and (out / "summary.json").exists()


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_a_link_made_during_a_run_is_not_followed(tmp_path):
    (tmp_path / "precious").write_text("mine")
    with RunFolder(tmp_path / "out") as folder:
        folder.append_history({"t": 0.0})
        (tmp_path / "out" / "history.csv").unlink()
        (tmp_path / "out" / "history.csv").symlink_to(tmp_path / "precious")
        with pytest.raises(OSError, match="symbolic link"):
            folder.append_history({"t": 1.0})
        (tmp_path / "out" / "frames").symlink_to(tmp_path)
        with pytest.raises(RunFolderError, match="symbolic link"):
            folder.write_frame(0.0, MESH, X)
    assert (tmp_path / "precious").read_text() == "mine"


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
    with pytest.raises(RunFolderError, match="name of the folder is empty"):
        RunFolder("")
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


def test_two_runs_cannot_share_a_folder(tmp_path):
    with RunFolder(tmp_path) as folder:
        with pytest.raises(RunFolderError, match=f"in use by process {os.getpid()} on"):
            RunFolder(tmp_path)
    folder.close()  # a second time does nothing
    RunFolder(tmp_path).close()
    assert not (tmp_path / ".lock").exists()


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
    assert [path.name for path in tmp_path.glob(".*")] == [".files"]


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="open files are listed in /proc")
@pytest.mark.parametrize("failing", ["write", "fsync"])
def test_a_full_disk_leaves_no_lock_and_nothing_open(tmp_path, monkeypatch, failing):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with RunFolder(tmp_path / "before") as folder:
        fill(folder)
    before = os.listdir("/proc/self/fd")
    monkeypatch.setattr(os, failing, full)
    with pytest.raises(OSError, match="No space left"):
        with RunFolder(tmp_path / "out") as folder:
            folder.write_text("case.toml", "[surface]\n")
    assert len(os.listdir("/proc/self/fd")) == len(before)
    assert not (tmp_path / "out" / ".lock").exists()


def test_a_line_that_a_kill_cut_short_does_not_spoil_the_next(tmp_path):
    for torn, rows in (("1,0.", 1), ("", 1), ("step,cos", 0)):
        folder = RunFolder(tmp_path / f"out{rows}{torn}")
        folder.append_history({"step": 0, "cost": 2.0})
        path = folder.path / "history.csv"
        text = path.read_text(encoding="utf-8") if rows else ""
        path.write_text(text + torn, encoding="utf-8")
        folder.mend_history()
        folder.append_history({"step": 1, "cost": 1.0})
        assert [row["step"] for row in read_history(path)] == ([0, 1] if rows else [1])
        folder.close()


def test_a_branch_is_brought_back_to_its_checkpoint(tmp_path):
    """Later shapes go, lost ones are named, and what others wrote stays."""
    rows = [{"point": number, "energy": 1.0 + number} for number in range(3)]
    with RunFolder(tmp_path / "out") as folder:
        for number in (0, 2, 3, 4):
            folder.write_shape(number, *icosphere(0, 1))
        folder.write_summary({})
        (folder.path / "shapes" / "mine.npz").write_bytes(b"")
        assert folder.keep_branch(rows) == [1]
        left = {path.name for path in (folder.path / "shapes").iterdir()}
        assert left == {"shape_000000.npz", "shape_000002.npz", "mine.npz"}
        assert read_history(folder.path / "branch.csv") == rows
        assert not (folder.path / "summary.json").exists()

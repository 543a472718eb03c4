"""A branch that was stopped leaves, once resumed, what the branch leaves that was not stopped."""

import json
import os
import shutil
import signal

import pytest

from jaxwillmore.cases import CaseError, load_case
from jaxwillmore.cli import main
from jaxwillmore.equilibria import name_of, parts_of
from jaxwillmore.io import (
    CheckpointWarning,
    RunFolder,
    RunFolderError,
    read_branch,
    read_branch_checkpoint,
    read_history,
    write_branch_checkpoint,
)
from jaxwillmore.io._plain import plain
from jaxwillmore.runs import resume_branch, run_branch

CASE = {
    "surface": {"shape": "ellipsoid", "semi_axes": [1.0, 1.0, 2.0], "level": 0},
    "constraints": {"area": "initial", "reduced_volume": 0.8},
    "branch": {"stop": 0.76, "step0": 0.01, "max_step": 0.01},
    "output": {"picture": False},
}


def case_of(**branch):
    return load_case(CASE | {"branch": CASE["branch"] | branch}, "branch")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The branch that nothing stops."""
    return run_branch(case_of(), tmp_path_factory.mktemp("branches") / "whole")


def interrupted_at(point, number, folder):
    """A branch that a signal reaches at a point; its folder."""

    def interrupt(row):
        if row.get("point") == point:
            os.kill(os.getpid(), number)

    run = run_branch(case_of(), folder, progress=interrupt)
    assert run.summary["status"] == "interrupted" and run.summary["points"] == point + 1
    return run.folder


def killed_at(point, folder):
    """What a kill leaves: the exception passes by all that is written at the end."""

    class Killed(BaseException):
        pass

    def kill(row):
        if row.get("point") == point:
            raise Killed

    with pytest.raises(Killed):
        run_branch(case_of(), folder, progress=kill)
    assert not (folder / "summary.json").exists()
    return folder


def said_of(branch):
    words, arrays = parts_of(branch)
    words["points"][0]["stats"] = words["points"][0]["stats"] | {"seconds": None}
    return json.dumps(plain(words)), {name: array.tobytes() for name, array in arrays.items()}


def assert_same(folder, whole):
    """Every file is the same, but for the time on the clock and the list of files."""
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert names == {
        p.relative_to(whole.folder).as_posix() for p in whole.folder.rglob("*") if p.is_file()
    }
    for name in names - {".files", "summary.json", "checkpoint.npz"}:
        assert (folder / name).read_bytes() == (whole.folder / name).read_bytes(), name
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary | {"wall_seconds": None} == whole.summary | {"wall_seconds": None}
    one, other = (read_branch(f / "checkpoint.npz") for f in (folder, whole.folder))
    assert said_of(one) == said_of(other)


def test_a_branch_leaves_a_checkpoint_that_is_the_branch(whole):
    assert whole.succeeded and whole.summary["points"] == len(whole.points) > 4
    assert not (whole.folder / "checkpoint_previous.npz").exists()
    found = read_branch(whole.folder / "checkpoint.npz")
    assert name_of(found.result) == "end_reached" and len(found.points) == len(whole.points)
    table = [{"point": number, **row} for number, row in enumerate(found.rows)]
    assert table == read_history(whole.folder / "branch.csv")


def test_an_interrupted_branch_goes_on_to_the_last_bit(whole, tmp_path):
    folder, rows = interrupted_at(2, signal.SIGTERM, tmp_path / "out"), []
    run = resume_branch(folder, progress=rows.append)
    assert run.succeeded and run.folder == folder
    assert rows == read_history(whole.folder / "branch.csv")[3:]
    assert_same(folder, whole)


@pytest.mark.parametrize("point", [1, 3])
def test_a_killed_branch_goes_on_from_its_checkpoint(whole, tmp_path, point):
    folder = killed_at(point, tmp_path / "out")
    # the point is in the folder already, and its checkpoint is not
    assert len(read_branch_checkpoint(folder / "checkpoint.npz").branch.points) == point
    with open(folder / "branch.csv", "a", encoding="utf-8") as file:
        file.write("12,0.3")  # a line cut short
    (folder / "shapes" / "shape_000000.npz").unlink()
    resume_branch(folder)
    assert_same(folder, whole)


def test_a_checkpoint_that_cannot_be_used_gives_way_to_the_older_one(whole, tmp_path):
    folder = killed_at(3, tmp_path / "out")
    newest = folder / "checkpoint.npz"
    newest.write_bytes(newest.read_bytes()[:-100])
    with pytest.warns(CheckpointWarning, match="no whole branch.*the branch goes on from"):
        resume_branch(folder)
    assert_same(folder, whole)


def test_a_branch_that_ended_says_so_and_takes_more_points(whole, tmp_path):
    run_branch(case_of(max_points=2), tmp_path / "out")
    again = resume_branch(tmp_path / "out")
    (note,) = again.summary["notes"]
    assert "had ended (point_limit), and nothing was computed; a larger `max_points`" in note
    with pytest.raises(CaseError, match=r"\[branch\].*max_points.*only be raised.*it is 2"):
        resume_branch(tmp_path / "out", max_points=1)
    more = resume_branch(tmp_path / "out", max_points=100)
    assert (
        more.succeeded and load_case(more.folder / "case.toml", "branch").branch.max_points == 100
    )
    assert_same(more.folder, whole)
    (note,) = resume_branch(whole.folder).summary["notes"]
    assert note == "the branch had ended (end_reached), and nothing was computed"


def test_folders_without_a_branch_to_go_on_with_say_what_to_do(whole, tmp_path, capsys):
    with pytest.raises(RunFolderError, match="holds no branch to go on with: it has no `case.tom"):
        resume_branch(tmp_path / "nothing")
    folder = killed_at(1, tmp_path / "out")
    case = (folder / "case.toml").read_text(encoding="utf-8")
    (folder / "case.toml").write_text(case.replace("stop = 0.76", "stop = 0.7"), encoding="utf-8")
    with pytest.raises(RunFolderError, match="not the case that this run began with.*Undo"):
        resume_branch(folder)
    (folder / "case.toml").write_text(case, encoding="utf-8")
    assert main(["run", "--resume", str(folder)]) == 2
    assert "holds a branch, not a run" in capsys.readouterr().err
    for name in ("checkpoint.npz", "checkpoint_previous.npz"):
        (folder / name).unlink(missing_ok=True)
    assert main(["branch", "--resume", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "holds no checkpoint" in error and "--replace" in error and error.count("\n") == 1
    # and that works
    command = error[error.index("jaxwillmore branch") :].split()[1:]
    assert main([*command, "--quiet"]) == 0
    assert_same(folder, whole)


def test_a_case_that_the_checkpoint_does_not_belong_to_is_refused(whole, tmp_path):
    """Both are whole: somebody put the checkpoint of another branch there."""
    folder = killed_at(1, tmp_path / "out")
    other = tmp_path / "other"
    shutil.copytree(whole.folder, other)
    with RunFolder(other, "resume") as opened:
        opened.write_text("case.toml", case_of(max_step=0.005).to_toml())
        checkpoint = opened.read_branch_checkpoint()
    (other / "checkpoint.npz").unlink()
    so_far = read_branch(folder / "checkpoint.npz")
    write_branch_checkpoint(other / "checkpoint.npz", so_far, checkpoint.metadata)
    with pytest.raises(RunFolderError, match="cannot go on.*`max_step` = 0.01; got 0.005"):
        resume_branch(other)


def test_another_version_is_a_note(tmp_path, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr("jaxwillmore.io._computer.__version__", "0.0.7")
        folder = killed_at(2, tmp_path / "out")
    assert main(["branch", "--resume", str(folder)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "note: the branch was begun elsewhere (jaxwillmore 0.0.7 -> " in captured.out


def test_a_full_disk_under_a_checkpoint_is_one_warning(whole, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RunFolder, "write_branch_checkpoint", full)
    with pytest.warns(UserWarning, match="no checkpoint.*No space left.*goes on") as caught:
        run = run_branch(case_of(), tmp_path / "out")
    assert run.succeeded and len(caught) == 1
    table = (run.folder / "branch.csv").read_bytes()
    assert table == (whole.folder / "branch.csv").read_bytes()


def test_the_command_line_takes_a_case_or_a_folder_to_resume(capsys):
    for arguments, words in (
        (["branch"], "required: CASE.toml, --out"),
        (["equilibrium", "case.toml"], "required: --out"),
        (["branch", "case.toml", "--out", "out", "--max-points", "9"], "--max-points goes with"),
        (["branch", "case.toml", "--resume", "out"], "takes no case"),
        (["branch", "--resume", "out", "--replace"], "takes no case"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert caught.value.code == 2
        assert words in capsys.readouterr().err
    assert main(["equilibrium", "--resume", "out"]) == 2
    error = capsys.readouterr().err
    assert "takes seconds. Find it again: jaxwillmore equilibrium out/case.toml" in error

"""A run that was stopped leaves, once resumed, what the run leaves that was not stopped."""

import json
import os
import re
import signal
import warnings

import pytest

from jaxwillmore.cases import CaseError, load_case
from jaxwillmore.cli import main
from jaxwillmore.evolve import parts_of
from jaxwillmore.io import (
    CheckpointWarning,
    History,
    PvdSeries,
    RunFolder,
    RunFolderError,
    read_checkpoint,
    read_history,
    write_checkpoint,
)
from jaxwillmore.runs import resume_case, run_case

# Held area and volume, tangential motion, adaptive steps; one mesh, so that it compiles once.
CASE = {
    "surface": {"shape": "ellipsoid", "semi_axes": [1.0, 1.0, 1.3], "level": 1, "degree": 1},
    "constraints": {"area": "initial", "volume": "initial"},
    "time": {"t1": 0.02},
    "output": {"every": 0.004, "picture": False, "checkpoint_steps": 3},
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The run that nothing stops."""
    return run_case(load_case(CASE), tmp_path_factory.mktemp("runs") / "whole")


def stopped_at(step, number, folder):
    """A run that a signal reaches in a step; its folder."""

    def interrupt(row):
        if row["step"] == step:
            os.kill(os.getpid(), number)

    run = run_case(load_case(CASE), folder, progress=interrupt)
    assert run.summary["status"] == "interrupted" and run.summary["steps"] == step
    return run.folder


def killed_at(step, folder):
    """What a kill leaves: the exception passes by all that is written at the end."""

    class Killed(BaseException):
        pass

    def kill(row):
        if row["step"] == step:
            raise Killed

    with pytest.raises(Killed):
        run_case(load_case(CASE), folder, progress=kill)
    assert not (folder / "summary.json").exists()
    return folder


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
    one, other = (read_checkpoint(f / "checkpoint.npz") for f in (folder, whole.folder))
    (words, arrays), (other_words, other_arrays) = parts_of(one.solution), parts_of(other.solution)
    for said in (words, other_words):
        said["stats"] = said["stats"] | {"wall_seconds": None}
    assert words == other_words and one.metadata == other.metadata
    for name, array in arrays.items():
        assert array.tobytes() == other_arrays[name].tobytes(), name


def test_a_run_leaves_a_checkpoint_beside_its_results(whole):
    assert whole.succeeded and whole.summary["steps"] > 8 and whole.summary["notes"] == []
    assert (whole.folder / "checkpoint.npz").is_file()
    assert not (whole.folder / "checkpoint_previous.npz").exists()
    assert read_checkpoint(whole.folder / "checkpoint.npz").solution.state.t == 0.02


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_an_interrupted_run_goes_on_to_the_last_bit(whole, tmp_path, number):
    folder = stopped_at(7, number, tmp_path / "out")
    last_frame = PvdSeries(folder / "run.pvd").entries()[-1][0]
    assert last_frame == read_history(folder / "history.csv")[-1]["t"]  # to be forgotten
    rows = []
    run = resume_case(folder, progress=rows.append)
    assert rows == read_history(whole.folder / "history.csv")[8:]
    assert run.succeeded and run.folder == folder
    assert_same(folder, whole)


@pytest.mark.slow
@pytest.mark.parametrize("step", [1, 5, 9])
def test_a_killed_run_goes_on_from_its_checkpoint(whole, tmp_path, step):
    folder = killed_at(step, tmp_path / "out")
    with open(folder / "history.csv", "a", encoding="utf-8") as file:
        file.write("12,0.3")  # a line cut short
    resume_case(folder)
    assert_same(folder, whole)


def test_a_damaged_checkpoint_falls_back_to_the_older_one_with_one_warning(whole, tmp_path):
    folder = killed_at(8, tmp_path / "out")
    newest = folder / "checkpoint.npz"
    newest.write_bytes(newest.read_bytes()[:-100])
    with pytest.warns(CheckpointWarning, match="no whole run") as caught:
        resume_case(folder)
    assert len(caught) == 1
    assert_same(folder, whole)


def test_a_full_disk_under_a_checkpoint_is_one_warning(whole, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RunFolder, "write_checkpoint", full)
    with pytest.warns(UserWarning, match="no checkpoint.*No space left.*goes on") as caught:
        run = run_case(load_case(CASE), tmp_path / "out")
    assert run.succeeded and len(caught) == 1
    history = (run.folder / "history.csv").read_bytes()
    assert history == (whole.folder / "history.csv").read_bytes()


def test_a_run_that_met_a_full_disk_goes_on(whole, tmp_path, monkeypatch):
    append = History.append

    def full(self, row):
        if row["step"] == 7:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write("7,0.00")
            raise OSError(28, "No space left on device")
        append(self, row)

    monkeypatch.setattr(History, "append", full)
    with pytest.raises(OSError, match="No space left"):
        run_case(load_case(CASE), tmp_path / "out")
    monkeypatch.undo()
    resume_case(tmp_path / "out")
    assert_same(tmp_path / "out", whole)


def test_a_run_that_ended_says_so_and_goes_further_with_a_later_end(tmp_path):
    run_case(load_case(CASE), tmp_path / "out")
    before = {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    again = resume_case(tmp_path / "out")
    assert again.succeeded
    assert again.summary["notes"] == [
        "the run had ended (reached_t1), and nothing was computed; a larger `t1` lets it go further"
    ]
    assert before == {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    with pytest.raises(CaseError, match=r"\[time\].*t1.*may only be raised.*0.02 and got 0.01"):
        resume_case(tmp_path / "out", t1=0.01)
    further = resume_case(tmp_path / "out", t1=0.03)
    assert further.summary["t"] == 0.03 and further.succeeded
    assert load_case(tmp_path / "out" / "case.toml").time.t1 == 0.03
    times = [t for t, _ in PvdSeries(further.folder / "run.pvd").entries()]
    assert times == pytest.approx([0.0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.024, 0.028, 0.03])
    rows = read_history(further.folder / "history.csv")
    assert [row["step"] for row in rows] == list(range(further.summary["steps"] + 1))


@pytest.mark.slow
def test_a_step_limit_is_raised(whole, tmp_path):
    case = load_case(CASE | {"time": {"t1": 0.02, "max_steps": 4}})
    run_case(case, tmp_path / "out")
    words = "had ended .step_limit.*a larger `max_steps`"
    assert re.search(words, resume_case(tmp_path / "out").summary["notes"][0])
    resume_case(tmp_path / "out", max_steps=10_000)
    assert_same(tmp_path / "out", whole)


def test_folders_without_a_run_to_go_on_with_say_what_to_do(whole, tmp_path, capsys):
    with pytest.raises(RunFolderError, match="holds no run to go on with: it has no `case.toml`"):
        resume_case(tmp_path / "nothing")
    assert not (tmp_path / "nothing").exists()
    folder = killed_at(5, tmp_path / "out")
    case = (folder / "case.toml").read_text(encoding="utf-8")
    (folder / "case.toml").write_text(case.replace("t1 = 0.02", "t1 = 0.03"), encoding="utf-8")
    with pytest.raises(RunFolderError, match="not the case that this run began with.*Undo"):
        resume_case(folder)
    (folder / "case.toml").write_text(case, encoding="utf-8")
    for name in ("checkpoint.npz", "checkpoint_previous.npz"):
        (folder / name).write_bytes(b"")
    with warnings.catch_warnings(), pytest.raises(RunFolderError, match="no whole run"):
        warnings.simplefilter("ignore", CheckpointWarning)
        resume_case(folder)
    for name in ("checkpoint.npz", "checkpoint_previous.npz"):
        (folder / name).unlink()
    assert main(["run", "--resume", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "holds no checkpoint" in error and "--replace" in error and error.count("\n") == 1
    # and that works
    command = error[error.index("jaxwillmore run") :].split()[1:]
    assert main([*command, "--quiet"]) == 0
    assert_same(folder, whole)


def test_history_that_lost_rows_leads_to_the_older_checkpoint_or_is_refused(whole, tmp_path):
    folder = killed_at(5, tmp_path / "out")
    lines = (folder / "history.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "history.csv").write_text("".join(lines[:3]), encoding="utf-8")
    with pytest.warns(CheckpointWarning, match="holds 2 rows; 4 were written; the run goes on"):
        resume_case(folder)
    assert_same(folder, whole)
    folder = killed_at(5, tmp_path / "empty")
    (folder / "history.csv").write_text("", encoding="utf-8")
    words = "history.csv` holds 0 rows; 4 were.*before it.*1 were written. To start it again: jax"
    with pytest.raises(RunFolderError, match=words):
        resume_case(folder)


def test_a_checkpoint_that_no_run_wrote_there_is_refused(whole, tmp_path):
    folder = killed_at(5, tmp_path / "out")
    read = read_checkpoint(folder / "checkpoint.npz")
    known, path = read.metadata, folder / "checkpoint.npz"
    for metadata, words in (
        ({}, "does not say where its run stood .frames, rows"),
        (known | {"rows": 3}, "written after 3 rows of history, and its run has 3 steps"),
        (known | {"frames": 9}, "lists 1 frames; 9 were written"),
    ):
        for _ in range(2):
            write_checkpoint(path, read.solution, metadata)
        with pytest.raises(RunFolderError, match=words):
            resume_case(folder)


def test_another_machine_is_a_note(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("jaxwillmore.io._computer._processors", lambda: 96)
        killed_at(5, folder)
    assert main(["run", "--resume", str(folder)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "note: the run was begun elsewhere (processors 96 -> " in captured.out
    assert "equal to tolerance, not to the last bit" in captured.out


def test_the_command_line_takes_a_case_or_a_folder_to_resume(tmp_path, capsys):
    for arguments, words in (
        (["run"], "required: CASE.toml, --out"),
        (["run", "case.toml"], "required: --out"),
        (["run", "case.toml", "--out", "out", "--t1", "2"], "go with --resume"),
        (["run", "case.toml", "--resume", "out"], "takes no case"),
        (["run", "--resume", "out", "--replace"], "takes no case"),
        (["run", "--resume", ""], "needs the name of a folder"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert caught.value.code == 2
        assert words in capsys.readouterr().err

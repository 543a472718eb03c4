"""Runs in files: every bit comes back, or an error says why not."""

import dataclasses
import json
import warnings

import jax
import numpy as np
import pytest

from jaxwillmore.evolve import Checkpoints, evolve, parts_of
from jaxwillmore.flows import WillmoreFlow
from jaxwillmore.io import (
    CheckpointWarning,
    SolutionError,
    _solution,
    previous_generation,
    read_checkpoint,
    read_solution,
    write_checkpoint,
    write_solution,
)
from jaxwillmore.mesh import ellipsoid

MESH, X = ellipsoid((1.0, 1.0, 1.3), 1, 1)


@pytest.fixture(scope="module")
def runs():
    """A run of two steps, as it was before each of them and at its end."""
    seen = []
    end = evolve(
        WillmoreFlow(),
        MESH,
        X,
        t1=2e-5,
        dt0=1e-5,
        saveat=1e-5,
        checkpoints=Checkpoints(seen.append, steps=1),
    )
    return [*seen, end]


def assert_same(one, two):
    (words, arrays), (other_words, other_arrays) = parts_of(one), parts_of(two)
    assert words == other_words and list(arrays) == list(other_arrays)
    for name, array in arrays.items():
        assert array.dtype == other_arrays[name].dtype, name
        assert array.tobytes() == other_arrays[name].tobytes(), name


def test_a_run_comes_back_to_the_last_bit(runs, tmp_path):
    for run in runs:
        write_solution(tmp_path / "run.npz", run)
        loaded = read_solution(tmp_path / "run.npz")
        assert_same(loaded, run)
        assert jax.tree.structure(loaded.saved) == jax.tree.structure(run.saved)
        assert loaded.records == run.records and loaded.times == run.times
    assert len(runs[-1].saved) == 3 and runs[-1].continuation.kept is not None


def test_equal_runs_make_equal_files(runs, tmp_path):
    for name in ("a.npz", "b.npz"):
        write_solution(tmp_path / name, runs[-1])
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_no_flipped_bit_is_ever_loaded(runs, tmp_path):
    path = tmp_path / "run.npz"
    write_solution(path, runs[-1])
    good, refused, tried = path.read_bytes(), 0, 0
    for position in range(0, len(good), len(good) // 400):
        flipped = bytes([good[position] ^ (1 << position % 8)])
        path.write_bytes(good[:position] + flipped + good[position + 1 :])
        tried += 1
        try:
            loaded = read_solution(path)
        except SolutionError as error:
            assert str(path) in str(error)
            refused += 1
        else:  # a flip in a date or a name of the archive harms nobody
            assert_same(loaded, runs[-1])
    assert refused > 0.6 * tried


def test_no_truncated_file_is_ever_loaded(runs, tmp_path):
    path = tmp_path / "run.npz"
    write_solution(path, runs[-1])
    good = path.read_bytes()
    for length in [0, 1, 10, *range(50, len(good), len(good) // 50), len(good) - 1]:
        path.write_bytes(good[:length])
        with pytest.raises(SolutionError, match="no whole run"):
            read_solution(path)


def test_foreign_newer_and_missing_files(runs, tmp_path, monkeypatch):
    path = tmp_path / "run.npz"
    with pytest.raises(FileNotFoundError, match="no file"):
        read_solution(path)
    np.savez(path, x=np.ones(3))
    with pytest.raises(SolutionError, match="not written by this package"):
        read_solution(path)
    path.write_bytes(b"something else")
    with pytest.raises(SolutionError, match="no whole run"):
        read_solution(path)
    np.savez(path, header=np.array([{"a": print}], dtype=object))
    with pytest.raises(SolutionError, match="Python objects"):
        read_solution(path)
    monkeypatch.setattr(_solution, "RUN", dataclasses.replace(_solution.RUN, version=2))
    write_solution(path, runs[0])
    monkeypatch.undo()
    with pytest.raises(SolutionError, match="format 2.*reads format 1"):
        read_solution(path)


def test_parts_that_make_no_run_are_refused(runs, tmp_path, monkeypatch):
    def without_x(solution):
        words, arrays = parts_of(solution)
        del arrays["x0"]
        return words, arrays

    monkeypatch.setattr(_solution, "parts_of", without_x)
    write_solution(tmp_path / "run.npz", runs[0])
    with pytest.raises(SolutionError, match="parts of a run.*x0"):
        read_solution(tmp_path / "run.npz")


def test_two_generations_are_kept_and_a_damaged_one_is_passed_over(runs, tmp_path):
    path = tmp_path / "c.npz"
    for step, run in enumerate(runs):
        write_checkpoint(path, run, {"step": step})
    last = len(runs) - 1
    assert_same(read_checkpoint(path).solution, runs[last])
    assert read_checkpoint(path).metadata == {"step": last}
    assert read_checkpoint(previous_generation(path)).metadata == {"step": last - 1}
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.warns(CheckpointWarning, match="no whole run.*goes on from `c_previous.npz`"):
        assert read_checkpoint(path).metadata == {"step": last - 1}
    path.unlink()
    with pytest.warns(CheckpointWarning, match="no file"):
        assert_same(read_checkpoint(path).solution, runs[last - 1])
    previous_generation(path).write_bytes(b"")
    with pytest.raises(SolutionError, match="no whole run|no file.*The checkpoint before it: .*no"):
        read_checkpoint(path)
    assert [p.name for p in tmp_path.iterdir()] == ["c_previous.npz"]


def test_a_failing_write_keeps_both_generations(runs, tmp_path, monkeypatch):
    path = tmp_path / "c.npz"
    for step in range(2):
        write_checkpoint(path, runs[0], {"step": step})
    with pytest.raises(TypeError, match="function"):
        write_checkpoint(path, runs[0], {"f": print})

    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="c.npz.*No space left"):
        write_checkpoint(path, runs[0], {"step": 2})
    monkeypatch.undo()
    assert read_checkpoint(path).metadata == {"step": 1}
    assert read_checkpoint(previous_generation(path)).metadata == {"step": 0}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.npz", "c_previous.npz"]


def test_another_computer_is_a_note(runs, tmp_path, monkeypatch):
    monkeypatch.setattr(jax, "__version__", "0.0.1")
    write_checkpoint(tmp_path / "c.npz", runs[0])
    monkeypatch.undo()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (note,) = read_checkpoint(tmp_path / "c.npz").notes
    assert "jax 0.0.1 ->" in note and "equal to tolerance" in note


def test_the_header_is_plain_json(runs, tmp_path):
    write_solution(tmp_path / "run.npz", runs[-1])
    with np.load(tmp_path / "run.npz") as archive:
        header = json.loads(archive["header"].tobytes())
    assert header["format"] == "jaxwillmore run" and header["computer"]["processors"] >= 1


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda w, a: a.update({"states.0.x": a["states.0.x"][:-1]}), r"x of the state.*\(41, 3\)"),
        (lambda w, a: a.update({"states.1.fields.H": a["x0"][1:, 0]}), "H of the saved state 0"),
        (lambda w, a: a.update(x0=a["x0"].T), "x0"),
        (lambda w, a: a.update({"history.U": a["history.U"][:, 1:]}), "U"),
        (lambda w, a: a.update({"kept.y": a["kept.y"][1:]}), "unknowns of the Jacobian"),
        (lambda w, a: a.update({"kept.hat": a["kept.hat"][1:]}), "hat"),
        (lambda w, a: a.update(times=a["times"][:-1]), "counts 2 steps.*2 of them and 2 times"),
        (
            lambda w, a: a.update({k: a[k][:1] for k in a if k.startswith("records")}),
            "counts 2 steps, and its history has 1 of them",
        ),
        (lambda w, a: w["states"][0].update(t=9.0), "at t = 9.0, its history at 2e-05"),
        (lambda w, a: w["states"][0].update(mesh=7), "parts of a run.*7"),
        (lambda w, a: a["numbers"].__setitem__(0, -1.0), "next step is -1.0"),
        (lambda w, a: a.update({"states.0.x": a["states.0.x"].astype("f4")}), "of float32"),
    ],
)
def test_a_run_whose_parts_do_not_fit_is_refused(runs, tmp_path, monkeypatch, change, message):
    """The checksum is right: some other program wrote it so.

    Where tests check shapes of arguments, these are the first to complain.
    """

    def broken(solution):
        words, arrays = parts_of(solution)
        arrays = {name: array.copy() for name, array in arrays.items()}
        change(words, arrays)
        return words, arrays

    path = tmp_path / "run.npz"
    write_checkpoint(path, runs[0], {"step": 0})
    monkeypatch.setattr(_solution, "parts_of", broken)
    write_checkpoint(path, runs[-1])
    with pytest.raises(SolutionError, match=message) as caught:
        read_solution(path)
    assert str(path) in str(caught.value) and "parts of a run" in str(caught.value)
    with pytest.warns(CheckpointWarning, match="goes on from `run_previous.npz`"):
        assert read_checkpoint(path).metadata == {"step": 0}


def test_a_history_of_other_fields_is_refused_by_the_flow(runs):
    c = runs[-1].continuation
    narrow = dataclasses.replace(c.history, U=c.history.U[:, :, 1:])
    bad = dataclasses.replace(runs[-1], continuation=dataclasses.replace(c, history=narrow))
    with pytest.raises(ValueError, match="history with .* = .*; this flow has"):
        evolve(WillmoreFlow(), MESH, X, t1=2e-5, dt0=1e-5, saveat=1e-5, resume=bad)

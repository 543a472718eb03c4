"""Branches in files: every bit comes back, or an error says why not."""

import dataclasses
import json
import warnings

import equinox as eqx
import numpy as np
import pytest

from jaxwillmore import equilibria
from jaxwillmore.energies import OsmoticPressure, Willmore
from jaxwillmore.io import (
    CheckpointWarning,
    SolutionError,
    _branch,
    previous_generation,
    read_branch,
    read_branch_checkpoint,
    read_solution,
    write_branch,
    write_branch_checkpoint,
)

from .test_branch_resume import assert_same


def test_a_branch_comes_back_to_the_last_bit(whole, tmp_path):
    for branch in (whole[0], *whole[1]):
        write_branch(tmp_path / "branch.npz", branch)
        assert_same(read_branch(tmp_path / "branch.npz"), branch)
    write_branch(tmp_path / "again.npz", branch)
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "branch.npz").read_bytes()


def test_a_table_may_hold_nan(whole, tmp_path):
    branch = whole[0]
    rows = ({**branch.rows[0], "negative_directions": float("nan")}, *branch.rows[1:])
    write_branch(tmp_path / "branch.npz", dataclasses.replace(branch, rows=rows))
    assert np.isnan(read_branch(tmp_path / "branch.npz").rows[0]["negative_directions"])


def test_energies_come_back_with_their_branch(whole, tmp_path):
    def with_energy(energy):
        where = lambda shape: shape.parameters.global_energy
        points = [
            eqx.tree_at(where, point, energy, is_leaf=lambda leaf: leaf is None)
            for point in whole[0].points
        ]
        return dataclasses.replace(whole[0], points=tuple(points))

    held = with_energy(0.5 * OsmoticPressure(3.5, 1.0, 1.0, 20.0))
    write_branch(tmp_path / "branch.npz", held)
    assert_same(read_branch(tmp_path / "branch.npz"), held)
    with pytest.raises(TypeError, match="energies.*of this package.*got a `Willmore`"):
        write_branch(tmp_path / "branch.npz", with_energy(Willmore()))
    assert_same(read_branch(tmp_path / "branch.npz"), held)


def test_no_damaged_file_is_ever_loaded(whole, tmp_path):
    path = tmp_path / "branch.npz"
    write_branch(path, whole[1][0])
    good = path.read_bytes()
    for position in range(0, len(good), len(good) // 60):
        path.write_bytes(good[:position])
        with pytest.raises(SolutionError, match="no whole branch"):
            read_branch(path)
        flipped = bytes([good[position] ^ (1 << position % 8)])
        path.write_bytes(good[:position] + flipped + good[position + 1 :])
        try:
            assert_same(read_branch(path), whole[1][0])
        except SolutionError as error:
            assert str(path) in str(error)


def test_files_of_other_kinds_versions_and_shapes_say_what_they_are(whole, tmp_path, monkeypatch):
    path, branch = tmp_path / "branch.npz", whole[1][0]
    with pytest.raises(FileNotFoundError, match="no file"):
        read_branch(path)
    write_branch(path, branch)
    with pytest.raises(SolutionError, match="branch.npz` holds a branch, not a run"):
        read_solution(path)
    newer = dataclasses.replace(_branch.BRANCH, version=2)
    with monkeypatch.context() as patch:
        patch.setattr(_branch, "BRANCH", newer)
        write_branch(path, branch)
    with pytest.raises(SolutionError, match="format 2, written by jaxwillmore.*reads format 1"):
        read_branch(path)
    shape = eqx.tree_at(lambda shape: shape.x, branch.points[0], np.eye(3))
    short = dataclasses.replace(branch, points=(shape,))
    with monkeypatch.context() as patch:
        patch.setattr("jaxwillmore.io._computer.__version__", "9.9")
        write_branch(path, short)
    with pytest.raises(SolutionError, match=r"'x' has shape \(1, 3, 3\).*by jaxwillmore 9.9: use"):
        read_branch(path)


def test_the_older_generation_is_tried_where_the_newest_cannot_be_used(whole, tmp_path):
    path, handed = tmp_path / "c.npz", whole[1]
    for step in range(2):
        write_branch_checkpoint(path, handed[step], {"step": step})
    newest = read_branch_checkpoint(path)
    assert newest.metadata == {"step": 1} and newest.path == path and newest.notes == ()
    bad = dataclasses.replace(handed[1], rows=handed[1].rows[:1])
    write_branch_checkpoint(path, bad)  # its checksum is right
    with pytest.warns(CheckpointWarning, match="2 points and 1 rows.*goes on from `c_previous"):
        older = read_branch_checkpoint(path)
    assert older.path == previous_generation(path)
    assert_same(older.branch, handed[1])

    def usable(found):
        raise ValueError("the table is gone")

    with warnings.catch_warnings(), pytest.raises(SolutionError) as caught:
        warnings.simplefilter("error")
        read_branch_checkpoint(path, usable)
    assert "1 rows" in str(caught.value) and "before it: `" in str(caught.value)
    assert "the table is gone" in str(caught.value)


def test_the_header_is_plain_json(whole, tmp_path):
    write_branch(tmp_path / "branch.npz", whole[0])
    with np.load(tmp_path / "branch.npz") as archive:
        header = json.loads(archive["header"].tobytes())
    assert header["format"] == "jaxwillmore branch"
    assert header["branch"]["result"] == equilibria.name_of(whole[0].result)

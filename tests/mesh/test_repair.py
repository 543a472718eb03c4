"""Repairs: what they do and what they leave, every act told, places never moved."""

import re

import numpy as np
import pytest

from jaxwillmore.mesh import SurfaceError, check_surface, icosphere, repair


def ball(level=1):
    mesh, x = icosphere(level, degree=1)
    return np.array(x), np.array(mesh.cells, dtype=np.int64)


V, F = ball()


def pair(shift, scale, level=0):
    v, f = ball(level)
    return np.concatenate([V, scale * v + shift]), np.concatenate([F, f + len(V)])


def test_a_sound_surface_is_left_as_it_is():
    x, faces, acts = repair(V, F)
    np.testing.assert_array_equal(x, V)
    np.testing.assert_array_equal(faces, F)
    assert acts == ()


def test_unused_vertices_are_dropped_and_the_others_numbered_again():
    x, faces, acts = repair(np.insert(V, 3, 9.0, axis=0), F + (F >= 3))
    np.testing.assert_array_equal(x, V)
    np.testing.assert_array_equal(faces, F)
    assert acts == ("dropped vertices without a face (1): 3",)


def test_collapsed_and_repeated_faces_are_dropped():
    bad = np.concatenate([[[0, 1, 1]], F, F[5:7], [[2, 2, 2]]])
    x, faces, acts = repair(V, bad)
    np.testing.assert_array_equal(faces, F)
    assert acts == (
        "dropped faces that name a vertex twice (2): 0, 83",
        "dropped faces that repeat an earlier one (2): 80, 81",
    )


def test_the_largest_piece_is_that_of_the_largest_area_not_of_the_most_faces():
    v, f = pair(5.0, 0.5, level=2)  # 320 small faces, 80 large ones
    x, faces, acts = repair(v, f, keep="largest")
    np.testing.assert_array_equal(x, V)
    np.testing.assert_array_equal(faces, F)
    (act,) = acts
    assert re.fullmatch(r"dropped 1 of 2 pieces: 162 vertices and 320 faces, 0\.2\d* of .*", act)
    assert repair(v, f, keep="largest", components=2).acts == ()


def test_small_pieces_are_dropped_by_their_part_of_the_area():
    v, f = pair(5.0, 0.1)
    assert repair(v, f, smallest_piece=0.001).acts == ()
    x, faces, _ = repair(v, f, smallest_piece=0.1)
    np.testing.assert_array_equal(faces, F)


def test_vertices_are_merged_within_a_distance_and_exactly():
    corners, numbers = V[F].reshape(-1, 3), np.arange(3 * len(F)).reshape(-1, 3)
    x, faces, acts = repair(corners, numbers, merge=0.0)
    assert check_surface(x, faces).ok and len(x) == len(V)
    assert acts == ("made one of vertices at most 0 apart: 198 fewer",)
    noise = 1e-8 * np.random.default_rng(0).normal(size=corners.shape)
    x, faces, _ = repair(corners + noise, numbers, merge=1e-6)
    assert check_surface(x, faces).ok and len(x) == len(V)


def test_a_tolerance_that_leaves_no_surface_is_refused():
    v, f = ball(3)
    with pytest.raises(SurfaceError, match="Lower the tolerance"):
        repair(v, f, merge=10.0)


def test_what_was_not_asked_for_is_not_done():
    bad = np.concatenate([F[:, ::-1], F[:1, ::-1], [[0, 1, 1]]])
    v = np.concatenate([V, [[9.0, 9, 9]]])
    nothing = dict.fromkeys(("collapsed", "repeated", "unused", "outward"), False)
    x, faces, acts = repair(v, bad, **nothing)
    np.testing.assert_array_equal(x, v)
    np.testing.assert_array_equal(faces, bad)
    assert acts == ()


@pytest.mark.parametrize("seed", range(5))
def test_everything_at_once_is_a_sound_surface_again(seed):
    rng = np.random.default_rng(seed)
    v, f = pair(4.0, 0.3)
    f = np.where(rng.uniform(size=len(f))[:, None] < 0.5, f[:, ::-1], f)
    f = np.concatenate([f, f[:3], [[1, 1, 2]]])
    order = rng.permutation(len(f))
    x, faces, acts = repair(np.concatenate([v, rng.normal(size=(4, 3))]), f[order], keep="largest")
    report = check_surface(x, faces)
    assert report.ok and len(acts) == 5
    assert report.volume == pytest.approx(check_surface(V, F).volume, rel=1e-12)


def test_a_piece_inside_another_stays_and_is_named():
    x, faces, _ = repair(*pair(0.0, 0.5))
    assert "nested_components" in check_surface(x, faces, components=2).kinds


@pytest.mark.parametrize(
    "vertices, faces, words",
    [
        (V, F + 1, "index_out_of_range"),
        (np.where(V > 0.9, np.nan, V), F, "non_finite"),
        (V, F[:, :2], "unreadable_faces"),
    ],
)
def test_what_is_no_triangulation_cannot_be_repaired(vertices, faces, words):
    with pytest.raises(SurfaceError, match=words):
        repair(vertices, faces)


def test_nothing_left_is_an_empty_surface():
    x, faces, _ = repair(V, [[0, 0, 1]])
    assert (len(x), len(faces)) == (0, 0)

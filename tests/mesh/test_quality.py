"""Quality of triangles: closed forms and invariance."""

import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.mesh import SurfaceMesh, icosphere, quality

from ..helpers import random_rotation


def test_icosahedron_is_perfect():
    mesh, x = icosphere(0, degree=2)
    q = quality(mesh, x)
    edge = 1 / np.sin(2 * np.pi / 5)
    np.testing.assert_allclose((q.h_min, q.h_max), edge, rtol=1e-14)
    np.testing.assert_allclose((q.min_angle, q.max_angle), 60.0, rtol=1e-13)
    np.testing.assert_allclose(q.chunkiness, 2 * np.sqrt(3), rtol=1e-13)
    np.testing.assert_allclose((q.area_ratio, q.edge_ratio), 1.0, rtol=1e-13)


def test_right_corner_of_a_cube_has_known_angles():
    mesh = SurfaceMesh(np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]), 1, 4)
    q = quality(mesh, np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    np.testing.assert_allclose((q.min_angle, q.max_angle), (45.0, 90.0), rtol=1e-14)
    np.testing.assert_allclose(q.area_ratio, np.sqrt(3), rtol=1e-14)
    np.testing.assert_allclose(q.edge_ratio, np.sqrt(2), rtol=1e-14)
    # Inscribed radius 1 − √2/2 and diameter √2 of the right triangles.
    np.testing.assert_allclose(q.chunkiness, np.sqrt(2) / (1 - np.sqrt(0.5)), rtol=1e-13)


def test_shape_ignores_rigid_motion_and_scale():
    mesh, x = icosphere(1, degree=1)
    before = quality(mesh, x)
    after = quality(mesh, 3.0 * x @ random_rotation(jr.key(0)).T)
    for name in ("chunkiness", "min_angle", "max_angle", "area_ratio", "edge_ratio"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=1e-12)
    np.testing.assert_allclose(after.h_max, 3 * before.h_max, rtol=1e-12)


@pytest.mark.parametrize("height", [1e-3, 1e-9])
def test_angles_of_needles_are_accurate(height):
    mesh = SurfaceMesh(np.array([[0, 1, 2], [0, 2, 1]]), 1, 3)
    q = quality(mesh, np.array([[0.0, 0, 0], [1, 0, 0], [0.5, height, 0]]))
    np.testing.assert_allclose(q.min_angle, np.degrees(np.arctan(2 * height)), rtol=1e-12)


def test_collapsed_triangle_has_infinite_chunkiness():
    mesh = SurfaceMesh(np.array([[0, 1, 2], [0, 2, 1]]), 1, 3)
    q = quality(mesh, np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]))
    assert q.chunkiness == q.area_ratio == np.inf

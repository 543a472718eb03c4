"""Triangles that pierce each other, against brute force; winding numbers."""

import numpy as np
import pytest

from jaxwillmore.mesh import icosphere
from jaxwillmore.mesh._intersections import piercing_faces, winding_number

MESH, X = icosphere(1, degree=1)
V, F = np.array(X), np.array(MESH.triangles)


def segment_meets_triangle(p, q, triangle):
    """By solving p + s (q − p) = a + u (b − a) + v (c − a)."""
    a, b, c = triangle
    matrix = np.stack([p - q, b - a, c - a], axis=1)
    if abs(np.linalg.det(matrix)) < 1e-14:
        return False
    s, u, v = np.linalg.solve(matrix, p - a)
    return 0 <= s <= 1 and u >= 0 and v >= 0 and u + v <= 1


def brute_force(faces, x):
    hit = set()
    for i, f in enumerate(faces):
        for j, g in enumerate(faces):
            if not set(f) & set(g):
                for e in range(3):
                    if segment_meets_triangle(x[f[e]], x[f[(e + 1) % 3]], x[g]):
                        hit |= {i, j}
    return sorted(hit)


@pytest.mark.parametrize("shift, scale", [(0.7, 1.0), (0.9, 0.3), (1.3, 1.0)])
def test_overlapping_spheres_are_found_as_by_brute_force(shift, scale):
    # The second sphere may be much smaller, and lies askew so that nothing just touches.
    x = np.concatenate([V, scale * V[:, [1, 2, 0]] + np.array([shift, 0.11, 0.07])])
    faces = np.concatenate([F, F + len(V)])
    found = piercing_faces(faces, x).tolist()
    assert found == brute_force(faces.tolist(), x)
    assert found


def test_an_edge_through_an_edge_counts():
    x = np.array(
        [[-1.0, 0, 0], [1, 0, 0], [0, 0, -1], [0, -1, 0.0], [0, 1, 0], [0, 0, 1]]
    )  # two triangles whose edges cross at the origin
    assert piercing_faces(np.array([[0, 1, 2], [3, 4, 5]]), x).tolist() == [0, 1]


def test_a_sphere_does_not_intersect_itself():
    assert len(piercing_faces(F, V)) == 0


def test_winding_number_tells_inside_from_outside():
    np.testing.assert_allclose(winding_number(np.array([0.1, 0.2, -0.3]), V[F]), 1.0, rtol=1e-12)
    np.testing.assert_allclose(winding_number(np.array([0.1, 0.2, -2.0]), V[F]), 0.0, atol=1e-12)
    np.testing.assert_allclose(winding_number(np.zeros(3), V[F[:, ::-1]]), -1.0, rtol=1e-12)

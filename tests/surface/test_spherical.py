"""Surfaces by harmonics: what a label image or a mesh of a cell becomes."""

import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.energies import Willmore
from jaxwillmore.mesh import SurfaceError
from jaxwillmore.surface import area, spherical, volume
from jaxwillmore.surface._conformal import conformal_sphere


def voxels(radius):
    """The boundary of the voxels whose centres are in a ball: squares, each as two triangles."""
    axis = np.arange(-radius - 1.0, radius + 2.0)
    inside = sum(a**2 for a in np.meshgrid(axis, axis, axis, indexing="ij")) < radius**2
    squares = []
    for k in range(3):
        u, v = np.eye(3)[(k + 1) % 3], np.eye(3)[(k + 2) % 3]
        for side in (-1, 1):
            outside = ~np.roll(inside, -side, axis=k)
            corner = axis[np.argwhere(inside & outside)] + 0.5 * side * np.eye(3)[k]
            ring = [-u - v, u - v, u + v, v - u][::side]
            squares.append(np.stack([corner + 0.5 * offset for offset in ring], axis=1))
    squares = np.concatenate(squares)
    points, number = np.unique(squares.reshape(-1, 3), axis=0, return_inverse=True)
    a, b, c, d = number.reshape(-1, 4).T
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def triangles_of(mesh, x):
    return np.asarray(x)[: mesh.n_vertices], np.asarray(mesh.triangles)


def test_the_conformal_sphere_of_a_sphere_is_itself():
    x, faces = triangles_of(*meshes.icosphere(2, 1))
    np.testing.assert_allclose(conformal_sphere(3.0 * x + 1.0, faces), x, atol=2e-3)


@pytest.fixture(scope="module")
def staircase():
    return spherical(*voxels(6), max_degree=6, level=1)


def test_a_staircase_of_voxels_is_a_ball_again(staircase):
    """Area 1.5 times that of the ball on the staircase; as many voxels as its volume says."""
    mesh, x = staircase
    assert staircase.harmonic_degree <= 3 and staircase.area_change < -0.3
    assert min(staircase.errors.values()) == pytest.approx(0.43, abs=0.1)
    ball = 36 * np.pi * float(volume(mesh, x)) ** 2  # A³ of the sphere of this volume
    assert float(area(mesh, x)) ** 3 == pytest.approx(ball, rel=0.01)
    assert float(Willmore()(mesh, x)) == pytest.approx(8 * np.pi, rel=0.03)
    assert "harmonics of degree" in staircase.in_words() and len(staircase) == 2


def test_a_smooth_shape_keeps_its_details():
    """An ellipsoid, at a degree that its own vertices choose."""
    exact = meshes.ellipsoid((1.0, 1.2, 0.7), 3, 2)
    found = spherical(*triangles_of(*meshes.ellipsoid((1.0, 1.2, 0.7), 3, 1)), max_degree=9)
    assert found.harmonic_degree == 9 and found.rms < 2e-3
    for measure in (area, volume, Willmore()):
        assert float(measure(*found)) == pytest.approx(float(measure(*exact)), rel=6e-3)


def test_what_is_no_sphere_is_refused():
    with pytest.raises(SurfaceError, match="genus"):
        spherical(*triangles_of(*meshes.torus(level=1, degree=1)))
    x, faces = triangles_of(*meshes.icosphere(1, 1))
    with pytest.raises(ValueError, match="12 vertices determine no harmonics; 16 are the least"):
        spherical(*triangles_of(*meshes.icosphere(0, 1)))
    with pytest.raises(ValueError, match="42 vertices"):
        spherical(x, faces, max_degree=9)
    with pytest.raises(SurfaceError):
        spherical(x, faces[1:])


def test_errors_that_neighbours_share_are_no_shape():
    """A ball with steps of 3 % on patches of four vertices; single ones would choose degree 8."""
    mesh, n = meshes.icosphere(3, 1)
    centres = np.random.default_rng(0).normal(size=(160, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    steps = np.random.default_rng(1).choice([-0.03, 0.03], 160)
    patch = np.argmax(np.asarray(n) @ centres.T, axis=1)
    x = np.asarray(n) * (1 + steps[patch])[:, None]
    found = spherical(x, np.asarray(mesh.triangles), max_degree=8)
    assert found.harmonic_degree == 1
    assert found.errors[8] > 1.1 * found.errors[1]

"""Smoothing for any genus: what is taken off waves, noise and voxels, and what is kept."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.energies import Willmore
from jaxwillmore.mesh import SurfaceError
from jaxwillmore.surface import area, smoothed, volume

from .test_spherical import triangles_of, voxels


def legendre_6(z):
    return (231 * z**6 - 315 * z**4 + 105 * z**2 - 5) / 16


@pytest.fixture(scope="module")
def ripples():
    """A sphere with ripples of one wavelength, 2π/√(l(l + 1)) for l = 6, and their height."""
    x, faces = triangles_of(*meshes.icosphere(3, 1))
    return x * (1 + 0.01 * legendre_6(x[:, 2:])), faces, 2 * math.pi / math.sqrt(42)


def left_on_a_sphere(times):
    """Part of the height of ripples of degree 6 that is left where `wavelength` is `times` theirs.

    The ripples are vectors along the normal, 7/13 of them of degree 7 and 6/13 of degree 5.
    """
    lost = 2 ** (1 / 6) - 1
    parts = ((7 / 13, 56 / 42), (6 / 13, 30 / 42))
    return sum(part / (1 + lost * (times**2 * ratio) ** 2) ** 6 for part, ratio in parts)


@pytest.mark.parametrize("times", [1.0, pytest.param(0.65, marks=pytest.mark.slow)])
def test_a_wave_of_the_wavelength_is_halved(ripples, times):
    x, faces, wave = ripples
    found = smoothed(x, faces, times * wave)
    assert found.wavelength == pytest.approx(times * wave)
    r = np.linalg.norm(np.asarray(found.x), axis=1)
    z = np.asarray(found.x)[:, 2] / r
    (_, height), *_ = np.linalg.lstsq(np.stack([np.ones_like(r), legendre_6(z)], axis=1), r)
    assert height / 0.01 == pytest.approx(left_on_a_sphere(times), abs=0.04)
    assert left_on_a_sphere(1.0) == pytest.approx(0.5, abs=0.03)
    V = meshes.check_surface(x, faces).volume
    assert float(volume(*found)) == pytest.approx(V, rel=1e-10)


@pytest.fixture(scope="module")
def noisy_torus():
    """R = 2, r = 1 with errors of 3 % of r at every vertex."""
    mesh, x = meshes.torus(2.0, 1.0, level=2, degree=1)
    noise = np.random.default_rng(0).normal(scale=0.03, size=x.shape)
    return np.asarray(x) + noise, np.asarray(mesh.triangles)


def test_a_torus_keeps_its_handle_and_volume_and_loses_its_noise(noisy_torus):
    x, faces = noisy_torus
    found = smoothed(x, faces, 2.0)
    mesh, nodes = found
    V = float(volume(meshes.SurfaceMesh(faces, 1, len(x)), jnp.asarray(x)))
    assert mesh.genus == 1 and mesh.degree == 2
    assert float(volume(mesh, nodes)) == pytest.approx(V, rel=1e-10)
    rough = meshes.SurfaceMesh(faces, 1, len(x))
    exact = 8 * math.pi**2 / math.sqrt(3)  # 2π²c²/√(c² − 1) for c = R/r = 2
    raw = float(Willmore()(rough, x)) / exact
    assert raw > 1.5
    assert float(Willmore()(*found)) == pytest.approx(exact, rel=0.02)
    # The flat triangles enclose a few per cent less than the torus.
    scale = (V / (4 * math.pi**2)) ** (2 / 3)
    assert float(area(*found)) == pytest.approx(8 * math.pi**2 * scale, rel=0.01)
    assert "volume as theirs" in found.in_words() and len(found) == 2


def test_a_staircase_of_voxels_becomes_a_ball():
    """Left to choose, it takes waves as long as the terraces."""
    found = smoothed(*voxels(6), degree=1)
    ball = 36 * math.pi * float(volume(*found)) ** 2  # A³ of the sphere of this volume
    assert float(area(*found)) ** 3 == pytest.approx(ball, rel=0.03)
    assert float(Willmore()(*found)) == pytest.approx(8 * math.pi, rel=0.05)
    assert found.area_change < -0.3 and 6 < found.wavelength < 14


def test_what_cannot_be_smoothed_is_refused(noisy_torus):
    x, faces = noisy_torus
    with pytest.raises(SurfaceError, match="(?s)closed surface of one piece.*open_edges"):
        smoothed(x, faces[1:])
    two = np.concatenate([x, x + 9]), np.concatenate([faces, faces + len(x)])
    with pytest.raises(SurfaceError, match="(?s)one piece.*several_components"):
        smoothed(*two)
    for wavelength in (0.1, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="`wavelength` must be at least"):
            smoothed(x, faces, wavelength)
    with pytest.raises(ValueError, match="wavelength 12 is too long.*shorter"):
        smoothed(x, faces, 12.0)


def crossing():
    """A ball whose north pole was pulled out through the south pole."""
    x, faces = triangles_of(*meshes.icosphere(2, 1))
    x = np.array(x)
    x[np.argmax(x[:, 2])] = (0.01, 0.02, -1.5)
    return x, faces


@pytest.mark.parametrize("unit, place", [(1e-6, 0.0), (1e3, 5e6), (1.0, 5e3)])
def test_units_and_places_change_nothing(unit, place):
    """Metres; nanometres, and millimetres from the origin in them; and so in micrometres."""
    x, faces = triangles_of(*meshes.icosphere(2, 1))
    x = x * (1 + 0.02 * np.random.default_rng(0).normal(size=(len(x), 1)))
    one = _moved(x, faces, 1.0, 0.0)
    np.testing.assert_allclose(_moved(x, faces, unit, place), one, atol=1e-6)


def _moved(x, faces, unit, place):
    """Nodes after smoothing in another unit at another place, back where they were."""
    found = smoothed(unit * x + place, faces, 1.2 * unit, degree=1)
    return (np.asarray(found.x) - place) / unit


def test_a_surface_that_crosses_itself_is_named():
    """The mesh is read with a warning; what comes out of smoothing is refused if it still does."""
    x, faces = crossing()
    assert "self_intersections" in meshes.check_surface(x, faces).kinds
    with pytest.raises(ValueError, match="(?s)crosses or touches itself.*repair"):
        smoothed(x, faces, 1.2)

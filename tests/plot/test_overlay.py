"""Pictures of fits: cross-sections are where they should be, files are written."""

import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.plot import overlay_picture, profile_picture
from jaxwillmore.plot._overlay import section

pytest.importorskip("matplotlib")
MESH, X = meshes.icosphere(1, degree=2)


def test_a_plane_cuts_a_sphere_in_a_closed_circle():
    normal = np.array([0.0, 0.6, 0.8])
    centre = 0.5 * normal
    segments = section(MESH, np.asarray(X), centre, normal)
    np.testing.assert_allclose((segments - centre) @ normal, 0.0, atol=1e-12)
    radius = np.linalg.norm(segments - centre, axis=-1)
    np.testing.assert_allclose(radius, np.sqrt(0.75), rtol=5e-3)  # flat pieces of a P2 sphere
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    np.testing.assert_allclose(length, 2 * np.pi * np.sqrt(0.75), rtol=5e-3)


def test_pictures_are_written(tmp_path):
    overlay_picture(tmp_path / "overlay.png", (MESH, X), (MESH, 1.1 * X), title="twins", unit="µm")
    profiles = {"v": ([0.7, 0.8, 0.9], [1.2, 1.0, np.nan])}
    profile_picture(tmp_path / "profile.png", profiles, {"v": 0.8}, ylabel="misfit")
    for name in ("overlay.png", "profile.png"):
        assert (tmp_path / name).stat().st_size > 5000

"""The noise of positions is estimated, and what it does to curvature is foretold."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import Willmore
from jaxwillmore.mesh import SurfaceMesh, _noise, check_surface, icosphere, red_cell, scatter, torus
from jaxwillmore.mesh._noise import flat_willmore

MESH, SPHERE = icosphere(4, degree=1)
CELLS, X = np.asarray(MESH.triangles), np.asarray(SPHERE)
DISTANCE = np.sqrt(4 * np.pi / len(X))


def noisy(part, seed=0):
    return X + part * DISTANCE * np.random.default_rng(seed).normal(size=X.shape)


@pytest.mark.parametrize("part", [1e-3, 1e-2, 5e-2])
def test_the_noise_of_a_sphere_is_found(part):
    found = scatter(CELLS, noisy(part))
    assert found is not None
    assert found.relative == pytest.approx(part, rel=0.1)
    assert found.position == pytest.approx(part * DISTANCE, rel=0.1)


def test_a_part_of_the_vertices_is_enough(monkeypatch):
    whole = scatter(CELLS, noisy(1e-2))
    monkeypatch.setattr(_noise, "ENOUGH", 700)
    part = scatter(CELLS, noisy(1e-2))
    assert whole is not None and part is not None and part.position != whole.position
    assert part.position == pytest.approx(whole.position, rel=0.1)
    assert part.energy == pytest.approx(whole.energy, rel=0.2)


@pytest.mark.parametrize("part", [1e-2, 5e-2])
def test_the_energy_of_noise_is_what_the_finite_elements_say(part):
    x = noisy(part)
    found = scatter(CELLS, x)
    assert found is not None
    excess = float(Willmore()(SurfaceMesh(CELLS, 1, len(x)), jnp.asarray(x))) - 8 * np.pi
    assert found.energy == pytest.approx(excess, rel=0.25)
    assert found.smooth == pytest.approx(8 * np.pi, rel=0.15)


@pytest.mark.parametrize(
    ("mesh", "x"), [(MESH, SPHERE), red_cell(level=3, degree=1), torus(level=2, degree=1)]
)
def test_a_smooth_surface_is_not_called_rough(mesh, x):
    found = scatter(np.asarray(mesh.triangles), np.asarray(x))
    assert found is not None and found.share < 0.03
    assert not check_surface(np.asarray(x), np.asarray(mesh.triangles)).kinds


def test_a_mesh_too_coarse_to_tell_is_not_judged():
    mesh, x = icosphere(1, degree=1)
    assert scatter(np.asarray(mesh.triangles), np.asarray(x)) is None


def test_flat_triangles_have_the_energy_of_their_sphere():
    assert flat_willmore(CELLS, X) == pytest.approx(8 * np.pi, rel=2e-3)


def test_noise_is_named_with_its_size_and_with_what_to_do():
    report = check_surface(noisy(0.05), CELLS)
    (found,) = report.findings
    assert found.kind == "noise" and found.severity == "warning"
    assert "0.049 of the distance" in found.message and "is noise" in found.message
    assert "smooth" in found.advice and "degree 1" in found.advice
    assert "is noise" in str(check_surface(X, CELLS))  # said of every surface


def test_digits_are_judged_by_what_they_do_to_curvature():
    """The same float32 numbers are enough near the origin, and too few far from it."""
    near = (5 * X).astype(np.float32)
    far = (5 * X + [5e4, -2.5e4, 5e4]).astype(np.float32)
    assert not check_surface(near.astype(float), CELLS).kinds
    (found,) = check_surface(far.astype(float), CELLS).findings
    assert found.kind == "few_digits" and "Subtract the centre" in found.advice
    share = float(found.message.split("about ")[1].split("%")[0]) / 100
    assert share == pytest.approx(scatter(CELLS, far.astype(float)).share, rel=0.3)

"""Warnings: none on good surfaces, the right name on each kind of bad one."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import willmore_of_field
from jaxwillmore.health import HealthWarning, _warnings, health_warnings
from jaxwillmore.shapes import make_shape

from ..helpers import with_nan


@pytest.fixture(scope="module")
def sphere():
    mesh, x, exact = make_shape("sphere", level=1, degree=2)
    return mesh, x, exact.mean_curvature(x)


def kinds(*arguments, **options):
    return [warning.kind for warning in health_warnings(*arguments, **options)]


@pytest.mark.parametrize("shape, degree", [("sphere", 1), ("torus", 2), ("red_cell", 2)])
def test_good_surfaces_have_no_warnings(shape, degree):
    mesh, x, exact = make_shape(shape, level=1, degree=degree)
    assert kinds(mesh, x, exact.mean_curvature(x), self_intersection=True) == []


def test_a_field_that_left_its_surface_is_named(sphere):
    """The plain scheme's field energy on a red cell fell to 0.8 of 8π while the surface kept it."""
    mesh, x, H = sphere
    found = health_warnings(mesh, x, 0.9 * H)
    assert [w.kind for w in found] == ["field_energy_below_bound", "energies_apart"]
    below, apart = found
    np.testing.assert_allclose(below.value, willmore_of_field(mesh, x, 0.9 * H), rtol=1e-12)
    assert below.value < below.limit < 8 * np.pi
    assert apart.value == pytest.approx(1 - 0.81, abs=5e-3) and "field" in apart.message
    assert kinds(mesh, x, 1.2 * H) == ["energies_apart"]


def test_discretisation_error_is_allowed(sphere):
    """0.20 % below 8π with the exact field and a little less; the estimate there is 0.23 %."""
    mesh, x, H = sphere
    energy = float(willmore_of_field(mesh, x, 0.9997 * H))
    assert -2.3e-3 < energy / (8 * np.pi) - 1 < -1.8e-3
    assert kinds(mesh, x, 0.9997 * H) == []


def test_an_energy_below_the_bound_is_named(sphere, monkeypatch):
    """The energy of the nodes has not been seen below 8π on any mesh; others' discrete ones have.

    So the energy is replaced: by 75 % of 8π, what vertex-based energies reach on collapsed meshes.
    """
    mesh, x, _ = sphere
    monkeypatch.setattr(_warnings, "_willmore", lambda mesh, x: 0.75 * 8 * np.pi)
    (found,) = health_warnings(mesh, x)
    assert (found.kind, found.value) == ("energy_below_bound", 6 * np.pi)
    assert found.value < found.limit < 8 * np.pi and "8π" in found.message


def test_a_surface_flattened_to_a_disc_is_unresolved():
    """All of its curvature sits at a rim that no triangle sees."""
    mesh, x, _ = make_shape("sphere", level=1, degree=1)
    assert "unresolved_curvature" in kinds(mesh, x * jnp.array([[1.0, 1.0, 1e-2]]))


def test_an_icosahedron_is_unresolved():
    mesh, x, _ = make_shape("sphere", level=0, degree=1)
    assert kinds(mesh, x) == ["unresolved_curvature"]


def test_needles_displaced_nodes_and_folds_are_named(sphere):
    mesh, x, _ = sphere
    a, b = np.asarray(mesh.cells)[0, :2]
    needle = x.at[a].set(0.97 * x[b] + 0.03 * x[a])
    assert "small_angle" in kinds(mesh, needle)
    middle = np.asarray(mesh.cells)[0, 3]
    shifted = x.at[middle].add(0.3 * (x[b] - x[a]))
    found = {w.kind: w for w in health_warnings(mesh, shifted)}
    assert found["mid_node_offset"].value == pytest.approx(0.3, abs=0.02)
    assert "jw.mesh.remesh" in found["mid_node_offset"].message
    folded = x.at[middle].add(0.8 * (x[b] - x[a]))
    assert "collapsed_element" in kinds(mesh, folded)


def test_a_surface_through_itself_is_found_only_when_asked():
    mesh, x, _ = make_shape("sphere", level=2, degree=1)
    # The north pole pulled down through the south.
    pulled = jnp.where((x[:, 2] > 0.9)[:, None], x * jnp.array([[1.0, 1.0, -1.6]]), x)
    assert "self_intersection" not in kinds(mesh, pulled)
    found = {w.kind: w for w in health_warnings(mesh, pulled, self_intersection=True)}
    assert found["self_intersection"].value > 0


@with_nan
def test_nodes_that_are_not_finite_end_the_examination(sphere):
    mesh, x, H = sphere
    found = health_warnings(mesh, x.at[3, 0].set(jnp.nan), H)
    assert found == (HealthWarning("not_finite", 1.0, 0.0, "Nodes are not finite."),)

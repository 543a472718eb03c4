"""Reference surfaces, start shapes and measures of curved meshes."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import equilibria, mesh as meshes, surface
from jaxwillmore.equilibria._reference import advanced, prepare, reference


def sphere():
    mesh, x = meshes.icosphere(1, degree=2)
    return mesh, x, reference(mesh, *prepare(mesh), x)


def dirichlet(r, w):
    gradient = np.zeros(w.shape)
    stiffness, rows, cols = (np.asarray(a) for a in (r.stiffness, r.pattern.rows, r.pattern.cols))
    np.add.at(gradient, rows, stiffness[:, None] * np.asarray(w)[cols])
    return float(np.sum(w * gradient))


def test_advancing_keeps_the_normal_displacement_and_deforms_less():
    _, x, r = sphere()
    s = 0.1 * x[:, 2] ** 3
    w = advanced(r, s) - x
    np.testing.assert_allclose(jnp.sum(w * r.n, axis=1), s, atol=1e-12)
    assert dirichlet(r, w) < 0.9 * dirichlet(r, s[:, None] * r.n)


def test_a_translation_is_recovered_from_its_normal_part():
    _, x, r = sphere()
    shift = jnp.array([[0.1, -0.2, 0.3]])
    w = advanced(r, jnp.sum(shift * r.n, axis=1)) - x
    np.testing.assert_allclose(w, jnp.broadcast_to(shift, w.shape), atol=1e-10)


def test_rigid_rows_see_translations_and_no_breathing():
    _, x, r = sphere()
    area = 4 * np.pi
    np.testing.assert_allclose(r.rigid[:3] @ x[:, 0], [area / 3, 0, 0], atol=5e-3 * area)
    np.testing.assert_allclose(r.rigid @ jnp.ones(len(x)), np.zeros(6), atol=1e-12)


def test_smoothing_removes_facets():
    mesh, x = meshes.icosphere(1, degree=1)
    mesh2, x2 = meshes.raise_degree(mesh, x, 2)
    flat = x2.at[mesh2.n_nodes - len(x2) + len(x) :].get()
    midpoints = 0.97 * flat
    bumpy = x2.at[len(x) :].set(midpoints)
    smooth = equilibria.without_facets(mesh2, bumpy)

    def roughness(y):
        radius = jnp.linalg.norm(y, axis=1)
        return float(jnp.std(radius) / jnp.mean(radius))

    assert roughness(smooth) < 0.5 * roughness(bumpy)


@pytest.mark.parametrize("kind", ["prolate", "oblate"])
def test_spheroid_has_its_reduced_volume_and_unit_area_radius(kind):
    mesh, x = equilibria.spheroid(0.8, kind, level=2)
    assert abs(float(surface.reduced_volume(mesh, x)) - 0.8) < 1e-3
    assert abs(float(surface.area_radius(mesh, x)) - 1) < 1e-3


@pytest.mark.parametrize("v, kind", [(1.0, "prolate"), (0.0, "oblate"), (0.8, "pear")])
def test_spheroid_refuses(v, kind):
    with pytest.raises(ValueError, match="must"):
        equilibria.spheroid(v, kind)


def test_health_sees_a_mid_node_that_slid_along_its_edge():
    mesh, x = meshes.icosphere(1, degree=2)
    assert equilibria.mesh_health(mesh, x).is_sound
    a, b, mid = (int(mesh.cells[0, k]) for k in (0, 1, 3))
    slid = x.at[mid].add(0.3 * (x[b] - x[a]))
    health = equilibria.mesh_health(mesh, slid)
    assert health.mid_node_offset == pytest.approx(0.3, abs=0.02)
    assert not health.is_sound


def test_health_sees_a_cell_that_folds():
    """A mid-edge node that moves by y of the way to the third corner makes the area element
    1 − 2y there; angles see nothing of it."""
    mesh, x = meshes.icosphere(1, degree=2)
    mid, far = int(mesh.cells[0, 3]), int(mesh.cells[0, 2])
    before, after = (
        equilibria.mesh_health(mesh, x.at[mid].add(y * (x[far] - x[mid]))) for y in (0.0, 0.8)
    )
    assert before.min_jacobian > 0.5 and after.min_jacobian < -0.1
    assert before.min_angle == after.min_angle


@pytest.mark.parametrize("value, sound", [(0.06, True), (0.04, False), (-0.04, False)])
def test_a_cell_is_sound_above_a_twentieth_of_its_mean_area(value, sound):
    assert equilibria.MeshHealth(30.0, 0.0, value).is_sound == sound

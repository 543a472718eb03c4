"""Generated surfaces: exact, conforming, outward, and of the promised counts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.mesh import (
    beads_torus,
    dumbbell,
    ellipsoid,
    evans_fung,
    from_sphere_map,
    from_torus_map,
    icosphere,
    quality,
    red_cell,
    torus,
)
from jaxwillmore.reference import lagrange_basis, lagrange_gradients, quadrature

from ..helpers import observed_order, with_nan


def area_and_volume(mesh, x):
    rule, corners = quadrature(8), np.asarray(x)[np.asarray(mesh.cells)]
    points = np.einsum("ql,tld->tqd", lagrange_basis(mesh.degree, rule.points), corners)
    J = np.einsum("qla,tld->tqad", lagrange_gradients(mesh.degree, rule.points), corners)
    normal = np.cross(J[:, :, 0], J[:, :, 1])
    area = np.einsum("tq,q->", np.linalg.norm(normal, axis=-1), rule.weights)
    return area, np.einsum("tqd,tqd,q->", points, normal, rule.weights) / 3


@pytest.mark.parametrize("level", [0, 1, 2])
def test_icosphere_has_the_promised_counts(level):
    mesh, x = icosphere(level, degree=1)
    assert mesh.n_nodes == 10 * 4**level + 2
    assert mesh.n_cells == 20 * 4**level


# Area is of order 2, 4, 4, 6: odd degrees gain one order, even degrees two.
@pytest.mark.parametrize("degree, expected", [(1, 2.0), (2, 4.0), (3, 4.0), (4, 6.0)])
def test_area_and_volume_of_an_ellipsoid_converge(degree, expected):
    e = np.sqrt(3) / 2  # eccentricity of the semi-axes 1, 1, 2
    exact_area, exact_volume = 2 * np.pi * (1 + 2 / e * np.arcsin(e)), 8 * np.pi / 3
    found = [area_and_volume(*ellipsoid(level=level, degree=degree)) for level in (1, 2, 3)]
    hs = [2.0**-level for level in (1, 2, 3)]
    volume_errors = [abs(volume - exact_volume) for _, volume in found]
    assert observed_order(hs, volume_errors) > expected - 0.3, volume_errors
    area_errors = [abs(area - exact_area) for area, _ in found]
    assert observed_order(hs, area_errors) > expected - 0.3, area_errors


@pytest.mark.parametrize(
    "make, area, volume",
    [
        (red_cell, 33.25708682, 11.72861257),
        (evans_fung, 134.090, 94.091),
        (dumbbell, 6.33729845, 1.20158439),
        (torus, 0.4 * 4 * np.pi**2, 0.4**2 * 2 * np.pi**2),
    ],
)
def test_area_and_volume_are_those_of_the_profile(make, area, volume):
    found = area_and_volume(*make(level=2, degree=4))
    np.testing.assert_allclose(found, (area, volume), rtol=1e-5)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("make", [icosphere, torus])
def test_polynomial_triangles_pass_through_nodes_computed_by_either_neighbour(make, degree):
    mesh, x = make(level=1, degree=degree)
    points, cells = np.asarray(x), np.asarray(mesh.cells)
    # Nodes inside an edge stand in the order in which the triangle runs through the edge.
    inside = cells[:, 3 : 3 * degree].reshape(len(cells), 3, degree - 1)
    ends = np.stack([cells[:, :3], np.roll(cells[:, :3], -1, axis=1)], axis=-1)
    path = points[np.concatenate([ends[..., :1], inside, ends[..., 1:]], axis=-1)]
    steps = np.linalg.norm(np.diff(path, axis=2), axis=-1)
    assert steps.max() / steps.min() < 3  # equispaced up to the stretching of the map
    straight = np.linalg.norm(path[:, :, -1] - path[:, :, 0], axis=-1)
    assert np.all(steps.sum(axis=-1) < 1.2 * straight)  # a wrong order would run back and forth


def test_torus_counts_follow_the_radii():
    mesh, x = torus(1.0, 0.4, level=2, degree=1)
    assert mesh.n_vertices == 12 * 34
    assert quality(mesh, x).min_angle > 40
    mesh, _ = torus(1.0, 2**-0.5, n_major=11, n_minor=8, degree=2)
    assert (mesh.n_nodes, mesh.genus) == (352, 1)


def test_torus_mesh_has_the_mirror_symmetry_of_the_torus():
    _, x = torus(level=1, degree=3)
    mirrored = x * jnp.array([[1.0, 1.0, -1.0]])
    nearest = jnp.min(jnp.linalg.norm(mirrored[:, None] - x[None], axis=-1), axis=1)
    assert float(nearest.max()) < 1e-14


def test_generators_take_traced_sizes():
    slope = jax.jacfwd(lambda R: icosphere(0, degree=2, radius=R)[1])(2.0)
    np.testing.assert_allclose(jnp.linalg.norm(slope, axis=1), 1.0, rtol=1e-14)


def test_beads_are_resolved_even_at_level_zero():
    mesh, _ = beads_torus(level=0, n_beads=6, degree=1)
    assert mesh.n_vertices == 3 * 24


def test_any_map_makes_a_surface():
    mesh, x = from_sphere_map(lambda n: n * (1.0 + 0.2 * n[2]), level=1, degree=3)
    np.testing.assert_allclose(
        jnp.linalg.norm(x, axis=1), 1 + 0.2 * x[:, 2] / jnp.linalg.norm(x, axis=1), rtol=1e-13
    )
    ring = lambda s, t: jnp.stack(
        [(2 + jnp.cos(t)) * jnp.cos(s), (2 + jnp.cos(t)) * jnp.sin(s), jnp.sin(t)]
    )
    mesh, x = from_torus_map(ring, 8, 5, degree=2)
    assert mesh.genus == 1


@with_nan
@pytest.mark.parametrize(
    "f, message",
    [
        (lambda n: -n, "must preserve orientation"),
        (lambda n: n / 0.0, "not finite"),
        (lambda n: n[:2], r"points of shape \(3,\); got \(2,\)"),
    ],
)
def test_maps_that_make_no_surface_are_refused(f, message):
    with pytest.raises(ValueError, match=message):
        from_sphere_map(f, level=0)

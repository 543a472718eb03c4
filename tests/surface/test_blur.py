"""What a blur does to a surface, and taking it back."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jaxwillmore import mesh as meshes
from jaxwillmore.surface import (
    Ellipsoid,
    deblurred,
    from_image,
    spherical,
)

from .test_image import radius_at_half


@pytest.mark.parametrize("radius", [6.0, 12.0])
def test_a_blurred_ball_is_brought_back(radius):
    """All but the second order: (σ/r)⁴ of the radius and a little."""
    mesh, x = meshes.icosphere(1, 2)
    back = jnp.linalg.norm(deblurred(mesh, radius_at_half(radius, 1.0) * x, 1.0), axis=1)
    assert radius - radius_at_half(radius, 1.0) > 0.9 / radius
    np.testing.assert_allclose(back, radius, atol=3 / radius**3)


def test_an_equal_blur_moves_by_half_of_its_variance_times_the_curvature():
    axes = (1.0, 1.2, 0.8)
    mesh, x = meshes.ellipsoid(axes, 2, 2)
    moved = jnp.linalg.norm(deblurred(mesh, x, 0.1) - x, axis=1)
    np.testing.assert_allclose(moved, 0.005 * Ellipsoid(axes).mean_curvature(x), rtol=0.01)
    np.testing.assert_array_equal(deblurred(mesh, x, 0.0), x)


def test_an_unequal_blur_is_taken_back_from_an_image():
    """Along z twice as wide: the order of its axes, and a ball whose poles move less."""
    radius, sigma = 12.0, (2.0, 1.0, 1.0)
    axis = np.arange(-19.0, 20.0)
    r = np.sqrt(sum(a**2 for a in np.meshgrid(axis, axis, axis, indexing="ij")))
    # Each voxel is filled as far as a plane at this distance fills it.
    image = gaussian_filter(np.clip(radius + 0.5 - r, 0.0, 1.0), sigma)
    vertices, faces = from_image(image, threshold=0.5, voxel_size=1.0)
    mesh, x = spherical(vertices - 19.0, faces, level=1, max_degree=8)
    before, after = (np.linalg.norm(y, axis=1) - radius for y in (x, deblurred(mesh, x, sigma)))
    pole, equator = np.abs(x[:, 2]) > 0.9 * radius, np.abs(x[:, 2]) < 0.2 * radius
    # ½ tr(AS) at the pole: both along the surface are 1; at the equator 1 and 4.
    assert before[pole].mean() == pytest.approx(-1.0 / radius, abs=0.04)
    assert before[equator].mean() == pytest.approx(-2.5 / radius, abs=0.04)
    assert abs(after[pole].mean()) < 0.04 and abs(after[equator].mean()) < 0.04
    assert np.sqrt(np.mean(after**2)) < 0.2 * np.sqrt(np.mean(before**2))


@pytest.mark.parametrize(
    "blur, match",
    [
        (-0.1, "must not be negative"),
        (np.nan, "must not be negative"),
        ((0.1, 0.1), r"three in the order \(z, y, x\)"),
        (0.8, "says nothing"),
    ],
)
def test_a_blur_that_makes_no_sense_is_refused(blur, match):
    with pytest.raises(ValueError, match=match):
        deblurred(*meshes.icosphere(1, 2), blur)


def test_flat_triangles_have_no_curvature_to_go_by():
    with pytest.raises(ValueError, match="degree 2 or more"):
        deblurred(*meshes.icosphere(1, 1), 0.1)

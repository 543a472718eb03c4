"""Surfaces of images: where they lie, how they are turned, and which images are refused."""

import builtins

import numpy as np
import pytest
from scipy.special import erf

from jaxwillmore.mesh import SurfaceError, check_surface
from jaxwillmore.surface import from_image


def distances(shape, centre, sizes=(1.0, 1.0, 1.0)):
    """Of the centres of all voxels from a point, both (z, y, x)."""
    axes = (s * np.arange(n) - c for n, s, c in zip(shape, sizes, centre, strict=True))
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return np.sqrt(x**2 + y**2 + z**2)


def blurred(rho, radius, sigma):
    """A ball under a Gaussian: its convolution, in closed form."""
    a, b = (radius - rho) / (np.sqrt(2) * sigma), (radius + rho) / (np.sqrt(2) * sigma)
    edge = np.exp(-(a**2)) - np.exp(-(b**2))
    return 0.5 * (erf(a) + erf(b)) - sigma / (rho * np.sqrt(2 * np.pi)) * edge


def radius_at_half(radius, sigma):
    """Where the blurred ball has half of its height."""
    low, high = 0.5 * radius, 1.5 * radius
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if blurred(middle, radius, sigma) > 0.5 else (low, middle)
    return low


@pytest.mark.parametrize("radius", [5.0, 10.0])
def test_a_blurred_ball_at_half_of_its_height_is_a_ball(radius):
    """Linear interpolation is exact to second order in the voxel; area and volume of the facets."""
    sigma, centre = 1.0, np.array([15.2, 15.4, 14.9])
    image = blurred(distances((31, 31, 31), centre), radius, sigma)
    vertices, faces = from_image(image, threshold=0.5, voxel_size=1.0)
    exact = radius_at_half(radius, sigma)
    r = np.linalg.norm(vertices - centre[::-1], axis=1)
    assert np.abs(r - exact).max() < 0.3 / radius
    assert np.mean(r) == pytest.approx(exact, abs=0.05 / radius)
    report = check_surface(vertices, faces, genus=0)
    assert report.ok
    assert report.area == pytest.approx(4 * np.pi * exact**2, rel=0.4 / radius**2)
    assert report.volume == pytest.approx(4 / 3 * np.pi * exact**3, rel=0.7 / radius**2)


def test_half_of_the_height_lies_inside_by_half_of_sigma_squared_times_the_curvature():
    for radius in (8.0, 16.0):
        inward = radius - radius_at_half(radius, 1.0)
        assert inward == pytest.approx(0.5 * 2 / radius, rel=2 / radius**2)


def test_a_label_is_a_staircase_around_the_ball():
    """Vertices are half a voxel away at most and unbiased; the area is a tenth too large."""
    r = distances((27, 27, 27), (13.2, 13.4, 12.9))
    vertices, faces = from_image(r < 9.0, voxel_size=2.0)
    assert np.all(np.sort(vertices % 2.0, axis=1) == (0.0, 0.0, 1.0))
    off = np.linalg.norm(vertices - 2 * np.array([12.9, 13.4, 13.2]), axis=1) / 2 - 9.0
    assert np.abs(off).max() < 0.5 and abs(off.mean()) < 0.03
    report = check_surface(vertices, faces, genus=0)
    assert report.volume == pytest.approx(8 * 4 / 3 * np.pi * 9**3, rel=0.01)
    assert 1.05 < report.area / (4 * 4 * np.pi * 81) < 1.12


def test_axes_are_z_y_x_and_vertices_are_x_y_z():
    """An ellipsoid of half axes 3, 5, 7 along x, y, z, in voxels of three sizes."""
    sizes, half, centre = np.array([0.5, 0.4, 0.3]), np.array([7.0, 5.0, 3.0]), (8.0, 6.0, 4.0)
    shape = (33, 31, 28)
    axes = (
        (s * np.arange(n) - c) / a for n, s, c, a in zip(shape, sizes, centre, half, strict=True)
    )
    z, y, x = np.meshgrid(*axes, indexing="ij")
    vertices, faces = from_image(1 - z**2 - y**2 - x**2, threshold=0.0, voxel_size=sizes)
    off = np.sum(((vertices - centre[::-1]) / half[::-1]) ** 2, axis=1)
    assert np.abs(off - 1).max() < 0.01
    volume = check_surface(vertices, faces).volume
    assert volume == pytest.approx(4 / 3 * np.pi * np.prod(half), rel=0.01)


@pytest.mark.parametrize("seed", range(20))
def test_any_label_has_a_closed_surface(seed):
    """Voxels that touch in edges and corners, on which marching cubes of equal heights tear."""
    rng = np.random.default_rng(seed)
    inside = np.pad(rng.random((6, 7, 8)) < rng.uniform(0.3, 0.9), 1)
    vertices, faces = from_image(inside, voxel_size=1.0, keep_largest=True, genus=None)
    report = check_surface(vertices, faces, self_intersections=False)
    assert report.ok and report.volume > 0


def test_values_at_the_threshold_are_inside():
    r = np.round(distances((15, 15, 15), (7.0, 7.0, 7.0)))
    vertices, faces = from_image(-r, threshold=-4.0, voxel_size=1.0)
    same = from_image(-r, threshold=-4.0 - 1e-9, voxel_size=1.0)
    assert check_surface(vertices, faces, genus=0).ok and np.array_equal(faces, same[1])
    np.testing.assert_allclose(vertices, same[0], atol=2e-2)


def box(value=1, dtype=np.int64):
    image = np.zeros((9, 10, 11), dtype)
    image[3:6, 3:7, 3:8] = value
    return image


def test_of_several_labels_one_is_chosen():
    image = box()
    image[7, 8, 9] = 5
    vertices, faces = from_image(image, label=5, voxel_size=(3.0, 2.0, 1.0))
    np.testing.assert_allclose(vertices.mean(axis=0), (9.0, 16.0, 21.0))
    assert len(faces) == 8
    with pytest.raises(ValueError, match=r"2 labels, 1 \(60 voxels\), 5 \(1 voxels\): choose"):
        from_image(image, voxel_size=1.0)
    with pytest.raises(ValueError, match="Label 3 is nowhere in the image; it has 1"):
        from_image(image, label=3, voxel_size=1.0)
    with pytest.raises(ValueError, match="Label 0 is the outside"):
        from_image(image, label=0, voxel_size=1.0)


@pytest.mark.parametrize(
    "image, options, match",
    [
        (box()[0], {}, r"three axes .* the shape \(10, 11\)"),
        (box()[..., None], {}, r"the shape \(9, 10, 11, 1\)"),
        (box().astype(str), {}, "bool, integers or floats"),
        (np.zeros((0, 3, 3)), {"threshold": 0.5}, "no voxels"),
        (0 * box(), {}, "empty"),
        (box() > 2, {}, "empty"),
        (box().astype(float), {}, "from 0 to 1: give `threshold`"),
        (box(), {"label": 1, "threshold": 0.5}, "`label` for a segmented image or"),
        (box(), {"threshold": 1.5}, "0 and 1; got 1.5"),
        (box(), {"threshold": np.nan}, "0 and 1; got nan"),
        (box(), {"voxel_size": 0.0}, "must be positive; got 0.0"),
        (box(), {"voxel_size": (1.0, -1.0, 1.0)}, "must be positive"),
        (box(), {"voxel_size": (1.0, np.nan, 1.0)}, "must be positive"),
        (box(), {"voxel_size": (1.0, 2.0)}, r"three in the order \(z, y, x\)"),
    ],
)
def test_images_that_make_no_sense_are_refused(image, options, match):
    with pytest.raises(ValueError, match=match):
        from_image(image, **({"voxel_size": 1.0} | options))


def test_voxels_that_are_not_finite_are_counted():
    image = np.where(box() == 1, 1.0, 0.0)
    image[2, 3, 4] = image[3, 3, 4] = np.nan
    with pytest.raises(
        ValueError, match=r"2 voxels are NaN or infinite, the first at .* = \[2, 3, 4\]"
    ):
        from_image(image, threshold=0.5, voxel_size=1.0)


@pytest.mark.parametrize("axis, name", [(0, "z"), (1, "y"), (2, "x")])
def test_a_body_at_the_border_is_refused_with_its_side(axis, name):
    inside = np.moveaxis(box() == 1, axis, 0)
    first, last = inside[3:], inside[:5]
    for cut, words in ((first, f"first slice, {name} = 0"), (last, f"last slice, {name} = ")):
        with pytest.raises(
            ValueError, match=f"Label 1 touches the border of the image: the {words}"
        ):
            from_image(np.moveaxis(cut, 0, axis), voxel_size=1.0)
    dark = 1.0 - np.moveaxis(inside, 0, axis)
    with pytest.raises(ValueError, match="darker than its surroundings"):
        from_image(dark, threshold=0.5, voxel_size=1.0)


def test_several_bodies_and_cavities_are_counted_and_the_largest_can_be_kept():
    image = box()
    image[4, 5, 5] = 0
    image[7, 8, 9] = 1
    words = r"3 closed surfaces: 2 bodies of 54.7, 0.167 and 1 cavity of 0.167 .*`keep_largest"
    with pytest.raises(SurfaceError, match=words):
        from_image(image, voxel_size=1.0)
    vertices, faces = from_image(image, voxel_size=1.0, keep_largest=True)
    # A box between the outer centres, half a voxel on its sides, edges and corners cut.
    whole = 2 * 3 * 4 + 2 * 3 + 3 * 4 + 2 * 4 + 4 * (2 + 3 + 4) / 8 + 8 / 48
    assert check_surface(vertices, faces).volume == pytest.approx(whole, rel=1e-12)
    alone, same = from_image(box(), voxel_size=1.0)
    assert np.array_equal(faces, same) and np.array_equal(vertices, alone)


def test_handles_are_refused_unless_they_are_expected():
    image = box()
    image[3:6, 5, 5] = 0
    with pytest.raises(SurfaceError, match="Label 1 has 1 handle instead of 0") as refused:
        from_image(image, voxel_size=1.0)
    assert refused.value.report is not None and refused.value.report.euler_characteristic == 0
    for genus in (1, None):
        assert check_surface(*from_image(image, voxel_size=1.0, genus=genus), genus=1).ok


def test_the_missing_extra_is_named(monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **options):
        if name.startswith("skimage"):
            raise ImportError(name)
        return real(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"pip install 'jaxwillmore\[images\]'"):
        from_image(box(), voxel_size=1.0)

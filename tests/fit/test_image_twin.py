"""A known vesicle as a label image, and what a fit makes of it."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from jaxwillmore.equilibria import equilibrium, spheroid
from jaxwillmore.fit import match_shapes, rotation
from jaxwillmore.surface import (
    deblurred,
    from_image,
    recover_normal,
    reduced_volume,
    signed_distance,
    spherical,
)

RADIUS, V, H0 = 20.0, 0.7, -1.0  # R0 in voxels, reduced volume, H0·R0


def grey_image(mesh, x):
    """Voxels [z, y, x], filled as a plane at their distance fills them, under a Gaussian of one."""
    nodes, nu = np.asarray(x), np.asarray(recover_normal(mesh, x))
    low = np.floor(nodes.min(axis=0)) - 6
    shape = np.ceil(nodes.max(axis=0) + 7 - low).astype(int)[::-1]
    points = np.argwhere(np.ones(shape, bool))[:, ::-1] + low
    nearest = KDTree(nodes).query(points)[1]
    depth = -np.sum((points - nodes[nearest]) * nu[nearest], axis=1)
    near = np.abs(depth) < 2
    depth[near] = -np.asarray(signed_distance(mesh, x, jnp.asarray(points[near])))
    return gaussian_filter(np.clip(depth + 0.5, 0.0, 1.0).reshape(shape), 1.0)


@pytest.mark.slow
def test_a_label_of_20_voxels_tells_reduced_volume_and_spontaneous_curvature():
    """The table of `benchmarks/microscope.py`, its last row, with other noise."""
    mesh, x = spheroid(V, "oblate", level=2)
    true = equilibrium(
        mesh,
        RADIUS * x,
        area=4 * np.pi * RADIUS**2,
        reduced_volume=V,
        spontaneous_curvature=H0 / RADIUS,
    )
    turned = true.x @ rotation(jnp.array([0.3, -0.2, 0.5])).T
    image = grey_image(mesh, turned)
    image += 0.05 * np.random.default_rng(1).normal(size=image.shape)
    smooth, seen = spherical(*from_image(image > 0.5, voxel_size=1.0, keep_largest=True))
    x = deblurred(smooth, seen, 1.0)
    assert abs(float(reduced_volume(smooth, x)) - V) < 0.003
    fit = match_shapes([(smooth, x)], kind="oblate", level=2, tolerance=1e-4, throw=False)
    found, intervals = fit.shapes[0].parameters, fit.robust.intervals()
    assert abs(found["reduced_volume"] - V) < 0.003
    assert abs(found["radius"] / RADIUS - 1) < 0.003
    low, high = intervals["scaled_spontaneous_curvature"]
    assert low < H0 < high and high - low < 0.4
    assert fit.rms < 0.004 and fit.verdict.word in ("agrees", "local minimum suspected")

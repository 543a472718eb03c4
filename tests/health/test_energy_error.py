"""The estimate of the energy error: never below the measured one, and of its order."""

import math

import numpy as np
import pytest

from jaxwillmore.energies import Willmore
from jaxwillmore.health import energy_error, least_willmore
from jaxwillmore.shapes import SHAPES, make_shape

from ..helpers import observed_order


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape, degree, levels, order",
    [
        ("sphere", 1, (0, 1, 2), 2),
        ("sphere", 2, (0, 1, 2), 4),
        ("torus", 1, (0, 1), 2),
        ("torus", 2, (0, 1), 4),
    ],
)
def test_the_estimate_bounds_the_error_and_falls_at_its_order(shape, degree, levels, order):
    hs, estimates = [], []
    for level in levels:
        mesh, x, _ = make_shape(shape, level=level, degree=degree)
        error = float(Willmore()(mesh, x)) / SHAPES[shape].willmore - 1
        hs.append(1 / math.sqrt(mesh.n_cells))
        estimates.append(energy_error(mesh, x))
        assert abs(error) < estimates[-1], (level, error, estimates)
    # Coarse meshes under-resolve the curvature: the order shows itself roughly.
    assert abs(observed_order(hs, estimates) - order) < 0.6, estimates


def test_the_estimate_ignores_scale_and_position():
    mesh, x, _ = make_shape("ellipsoid", level=1, degree=2)
    moved = energy_error(mesh, 7.0 * x + 3.0)
    np.testing.assert_allclose(moved, energy_error(mesh, x), rtol=1e-9)


def test_least_energies():
    assert least_willmore(0) == 8 * math.pi
    assert least_willmore(1) == least_willmore(2) == 4 * math.pi**2

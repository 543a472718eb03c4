"""The picture of a branch: it is a PNG, shows what it should, and refuses nothing to draw."""

from typing import Any

import numpy as np
import pytest

from jaxwillmore.mesh import icosphere
from jaxwillmore.plot import PlotError, branch_picture
from jaxwillmore.plot._branch import _spread

NAMES = "reduced_volume", "bending_over_8pi_kappa", "negative_directions", "event"


def test_a_branch_becomes_a_picture(tmp_path):
    mesh, x = icosphere(0, degree=2)
    values = [(0.9, 1.2, 0, None), (0.8, 1.4, 1, "fold"), (0.82, 1.5, np.nan, None)]
    rows: list[dict[str, Any]] = [dict(zip(NAMES, row, strict=True)) for row in values]
    surfaces = [(mesh, np.asarray(x) * [1.0, 1.0, k + 1.0], x[:, 2]) for k in range(3)]
    path = tmp_path / "branch.png"
    branch_picture(path, rows, surfaces, NAMES[0], title="3", renderer="matplotlib")
    assert path.read_bytes().startswith(b"\x89PNG")


def test_shapes_are_spread_along_the_curve():
    p = np.array([0.0, 0.01, 0.02, 0.5, 1.0])
    chosen = _spread(p, 2 * p, 3)
    np.testing.assert_array_equal(chosen, [0, 3, 4])


def test_nothing_to_draw_is_refused(tmp_path):
    with pytest.raises(PlotError, match="a surface per row"):
        branch_picture(tmp_path / "b.png", [], [], NAMES[0])

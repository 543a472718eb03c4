"""What reading at degree 2 changes is limited, and said."""

import numpy as np
import pytest

from jaxwillmore.io import SurfaceWarning, read_surface, write_ply
from jaxwillmore.mesh import icosphere
from jaxwillmore.surface import area, volume

CUBE = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 1 4 3
f 1 3 2
f 5 6 7
f 5 7 8
f 1 2 6
f 1 6 5
f 2 3 7
f 2 7 6
f 3 4 8
f 3 8 7
f 4 1 5
f 4 5 8
"""


@pytest.mark.parametrize("degree", [2, 4])
def test_a_cube_stays_a_cube_and_its_creases_are_named(tmp_path, degree):
    (tmp_path / "cube.obj").write_text(CUBE)
    with pytest.warns(SurfaceWarning, match=r"creases \(12\)") as heard:
        mesh, x = read_surface(tmp_path / "cube.obj", degree=degree)
    assert not any("moved_by_degree" in str(warning.message) for warning in heard)
    assert float(area(mesh, x)) == pytest.approx(6.0) and float(volume(mesh, x)) == pytest.approx(1)


def test_a_surface_that_moves_by_more_than_three_per_cent_is_named(tmp_path):
    mesh, x = icosphere(0, degree=1)
    write_ply(tmp_path / "coarse.ply", mesh, x)
    with pytest.warns(SurfaceWarning, match="moved_by_degree") as heard:
        mesh, lifted = read_surface(tmp_path / "coarse.ply", degree=2)
    change = float(volume(mesh, lifted) / volume(*icosphere(0, degree=1))) - 1
    assert change > 0.03 and f"the volume by {change:+.1%}" in str(heard[0].message)
    read_surface(tmp_path / "coarse.ply", degree=1)  # nothing moves, nothing is said


def test_a_fine_smooth_surface_is_read_in_silence(tmp_path):
    mesh, x = icosphere(3, degree=1)
    write_ply(tmp_path / "fine.ply", mesh, x)
    mesh, lifted = read_surface(tmp_path / "fine.ply", degree=2)
    np.testing.assert_allclose(np.linalg.norm(lifted, axis=1), 1.0, atol=3e-6)

"""Pictures of surfaces: the fine surface is the curved one, the picture exists and shows it."""

import os
import subprocess
import sys

import numpy as np
import pytest

from jaxwillmore.mesh import ellipsoid, icosphere, red_cell, torus
from jaxwillmore.plot import PlotError, surface_picture
from jaxwillmore.plot._camera import camera_for
from jaxwillmore.plot._subdivide import subdivide

from ..helpers import with_nan


def pixels(path):
    image = pytest.importorskip("matplotlib.image")
    return image.imread(path)[..., :3]


# 1. The fine surface.
@pytest.mark.parametrize("degree, most", [(1, 0.2), (2, 5e-3), (3, 2e-3), (4, 1e-4)])
def test_drawn_points_lie_on_the_curved_sphere(degree, most):
    mesh, x = icosphere(1, degree=degree)
    fine = subdivide(mesh, np.array(x), np.array(x)[:, 2])
    assert np.abs(np.linalg.norm(fine.points, axis=1) - 1).max() < most
    assert np.linalg.norm(fine.normals - fine.points, axis=1).max() < 20 * most
    assert fine.values is not None
    np.testing.assert_allclose(fine.values, fine.points[:, 2], atol=1e-14)


@pytest.mark.parametrize("make", [icosphere, torus])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_drawn_triangles_are_closed_and_oriented_like_the_mesh(make, degree):
    mesh, x = make(level=1, degree=degree)
    fine = subdivide(mesh, np.array(x), most_triangles=9 * mesh.n_cells)
    s = 1 if degree == 1 else 3
    assert len(fine.triangles) == s * s * mesh.n_cells
    n_edges = len(fine.triangles) * 3 // 2
    assert len(fine.points) - n_edges + len(fine.triangles) == mesh.euler_characteristic
    directed = np.stack([fine.triangles, np.roll(fine.triangles, -1, axis=1)], axis=-1)
    directed = directed.reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == 2 * n_edges  # every edge once in each direction
    assert len(np.unique(np.sort(directed, axis=1), axis=0)) == n_edges
    a, b, c = np.moveaxis(fine.points[fine.triangles], 1, 0)
    assert np.sum(np.cross(b - a, c - a) * fine.normals[fine.triangles[:, 0]], axis=1).min() > 0
    assert len(fine.edges) == mesh.n_edges


def test_the_camera_is_a_rotation_and_sees_everything():
    clouds = [np.array(red_cell(1, 2)[1]), np.array(icosphere(1, 2)[1]) + 7.0]
    for view in (None, (1.0, 2.0, 3.0), (0.0, 0.0, -1.0)):
        camera = camera_for(clouds, view)
        np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(camera.axes), 1.0)
        for points in clouds:
            seen = (points - camera.centre(points)) @ camera.axes.T
            assert np.abs(seen[:, :2]).max() < camera.half_height
    with pytest.raises(ValueError, match="view"):
        camera_for(clouds, (0.0, 0.0, 0.0))


# 2. The picture.
@pytest.mark.parametrize("renderer", ["pyvista", "matplotlib"])
def test_colours_of_the_field_arrive_in_the_picture(tmp_path, renderer):
    pytest.importorskip(renderer)
    mesh, x = icosphere(1, degree=2)
    path = tmp_path / "a.png"
    up = np.array(x)[:, 2]
    used = surface_picture(
        path, mesh, x, up, view=(1.0, 0.0, 0.0), edges=False, dpi=40.0, renderer=renderer
    )
    assert used == renderer
    image = pixels(path)
    middle = image[:, : int(0.8 * image.shape[1])]  # without the colour bar
    coloured = np.ptp(middle, axis=2) > 0.15
    rows = np.flatnonzero(coloured.any(axis=1))
    upper, lower = middle[: rows[len(rows) // 3]], middle[rows[2 * len(rows) // 3] :]
    red_minus_blue = lambda part: (part[..., 0] - part[..., 2])[np.ptp(part, axis=2) > 0.15].mean()
    assert red_minus_blue(upper) > 0.2 and red_minus_blue(lower) < -0.2


@pytest.mark.parametrize("renderer", ["pyvista", "matplotlib"])
def test_the_silhouette_has_the_area_of_the_ellipse(tmp_path, renderer):
    """An ellipsoid seen along an axis covers π a b; equal axes are kept."""
    pytest.importorskip(renderer)
    mesh, x = ellipsoid((1.0, 0.5, 2.0), level=1, degree=3)
    path = tmp_path / "a.png"
    surface_picture(path, mesh, x, view=(1.0, 0.0, 0.0), dpi=60.0, renderer=renderer)
    inside = pixels(path).min(axis=2) < 0.97
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    tall, wide = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert abs(tall / wide - 4.0) < 0.15
    assert abs(inside.sum() / (np.pi / 4 * tall * wide) - 1.0) < 0.03


def test_start_and_end_side_by_side(tmp_path):
    pytest.importorskip("matplotlib")
    mesh, x = red_cell(1, 2)
    end, y = icosphere(1, 2)
    for name, start in (("a", (mesh, x)), ("b", None)):
        surface_picture(
            tmp_path / f"{name}.png", end, y, np.ones(len(y)), start=start, dpi=40.0,
            title="one\ntwo", caption="end", renderer="matplotlib",
        )  # fmt: skip
    assert pixels(tmp_path / "a.png").shape[1] > 1.6 * pixels(tmp_path / "b.png").shape[1]
    surface_picture(tmp_path / "c.png", mesh, x, start=2 * x, dpi=30.0, renderer="matplotlib")


@pytest.mark.parametrize(
    "field",
    [0.0, 3.0, -1e-12, 1e300, "spread"],
    ids=["zero", "constant", "tiny", "huge", "outliers"],
)
def test_any_finite_field_can_be_drawn(tmp_path, field):
    pytest.importorskip("matplotlib")
    mesh, x = icosphere(1, degree=1)
    values = np.full(42, field) if field != "spread" else np.arange(42) % 2 * 1e5
    surface_picture(
        tmp_path / "a.png", mesh, x, values, field_name="energy density", dpi=30.0,
        renderer="matplotlib",
    )  # fmt: skip
    assert (tmp_path / "a.png").stat().st_size > 1000


# 3. What cannot be drawn.
def test_a_machine_where_vtk_dies_gets_matplotlibs_picture(tmp_path, monkeypatch):
    """With neither a display nor EGL, VTK takes its process down; ours must survive."""
    pytest.importorskip("pyvista")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkXOpenGLRenderWindow")
    mesh, x = icosphere(1, degree=1)
    used = surface_picture(tmp_path / "a.png", mesh, x, dpi=30.0)
    assert (tmp_path / "a.png").exists()
    if used == "matplotlib":
        with pytest.raises(PlotError, match="cannot draw"):
            surface_picture(tmp_path / "b.png", mesh, x, dpi=30.0, renderer="pyvista")


def test_without_the_extra_there_is_a_plot_error(tmp_path, monkeypatch):
    mesh, x = icosphere(1, degree=1)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(PlotError, match=r"jaxwillmore\[viz\]"):
        surface_picture(tmp_path / "a.png", mesh, x)


@with_nan
def test_nothing_to_draw_is_a_plot_error(tmp_path):
    pytest.importorskip("matplotlib")
    mesh, x = icosphere(1, degree=1)
    with pytest.raises(PlotError, match="3 of 42 nodes are not finite"):
        surface_picture(tmp_path / "a.png", mesh, x.at[:3].set(np.nan))
    with pytest.raises(PlotError, match="no finite value"):
        surface_picture(tmp_path / "a.png", mesh, x, np.full(42, np.nan))
    with pytest.raises(PlotError, match="cannot write"):
        surface_picture(tmp_path / "no" / "a.png", mesh, x, renderer="matplotlib", dpi=30.0)
    with pytest.raises(ValueError, match=r"`field` needs shape \(42,\)"):
        surface_picture(tmp_path / "a.png", mesh, x, np.ones(41))
    assert not list(tmp_path.iterdir())


def test_importing_the_package_imports_no_plotting():
    program = "import jaxwillmore.plot, jaxwillmore.io, sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=os.environ
    )
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert not loaded & {"matplotlib", "pyvista", "vtk", "vtkmodules", "trimesh", "meshio"}

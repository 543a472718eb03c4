"""VTU files and their table of contents, read back exactly by meshio and by PyVista."""

import numpy as np
import pytest

from jaxwillmore.io import PvdSeries, write_vtu
from jaxwillmore.mesh import ellipsoid, icosphere

TYPES = {1: 5, 2: 22, 3: 69, 4: 69}


def frame(path, degree, time=None):
    mesh, x = ellipsoid((1.0, 1.2, 2.0), level=1, degree=degree)
    X = np.array(x)
    fields = {
        "H": np.sin(X[:, 0]),
        "velocity": X[::-1] / 3,
        'A <&> "ν"': np.einsum("ni,nj->nij", X, X),
    }
    write_vtu(path, mesh, x, fields, time=time)
    return np.array(mesh.cells), X, fields


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_pyvista_reads_back_every_digit(tmp_path, degree):
    pv = pytest.importorskip("pyvista")
    cells, x, fields = frame(tmp_path / "a.vtu", degree, time=0.1)
    grid = pv.read(tmp_path / "a.vtu")
    assert set(grid.celltypes.tolist()) == {TYPES[degree]}
    np.testing.assert_array_equal(grid.points, x)
    np.testing.assert_array_equal(grid.cell_connectivity.reshape(cells.shape), cells)
    assert grid.points.dtype == np.float64
    assert set(grid.point_data) == set(fields)
    for name, field in fields.items():
        np.testing.assert_array_equal(grid.point_data[name].reshape(field.shape), field)
    assert grid.field_data["TimeValue"].tolist() == [0.1]


@pytest.mark.parametrize("degree, name", [(1, "triangle"), (2, "triangle6")])
def test_meshio_reads_back_every_digit(tmp_path, degree, name):
    meshio = pytest.importorskip("meshio")
    cells, x, fields = frame(tmp_path / "a.vtu", degree, time=0.1)
    mesh = meshio.read(tmp_path / "a.vtu")
    assert [block.type for block in mesh.cells] == [name]
    np.testing.assert_array_equal(mesh.cells[0].data, cells)
    np.testing.assert_array_equal(mesh.points, x)
    for key in ("H", "velocity"):
        np.testing.assert_array_equal(mesh.point_data[key], fields[key])


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_vtk_puts_the_nodes_where_we_do(tmp_path, degree):
    """VTK's own subdivision of the curved sphere stays on the sphere, so the orders agree."""
    pv = pytest.importorskip("pyvista")
    mesh, x = icosphere(1, degree=degree)
    write_vtu(tmp_path / "a.vtu", mesh, x)
    surface = pv.read(tmp_path / "a.vtu").extract_surface(
        nonlinear_subdivision=3, algorithm="dataset_surface"
    )
    radius = np.linalg.norm(surface.points, axis=1)
    assert surface.n_points > mesh.n_nodes
    np.testing.assert_allclose(radius, 1.0, atol={2: 4e-3, 3: 1.2e-3, 4: 6e-5}[degree])


def test_blocks_of_compressed_data_join(tmp_path):
    """More than one megabyte per array, and exactly one megabyte."""
    pv = pytest.importorskip("pyvista")
    from jaxwillmore.io import _vtu

    mesh, x = icosphere(1, degree=1)
    assert np.array(x).nbytes == 1008
    for block in (100, 112, 1008, 4096):
        _vtu._BLOCK, old = block, _vtu._BLOCK
        try:
            write_vtu(tmp_path / "a.vtu", mesh, x)
        finally:
            _vtu._BLOCK = old
        np.testing.assert_array_equal(pv.read(tmp_path / "a.vtu").points, x)


def test_fields_of_the_wrong_shape_are_refused_and_nothing_is_written(tmp_path):
    mesh, x = icosphere(1, degree=1)
    for field in (np.ones(3), np.ones((3, 42)), np.float64(1.0), np.ones((42, 0))):
        with pytest.raises(ValueError, match="field 'H'.*42"):
            write_vtu(tmp_path / "a.vtu", mesh, x, {"H": field})
    assert not list(tmp_path.iterdir())


def test_pvd_gives_pyvista_the_physical_times(tmp_path):
    pv = pytest.importorskip("pyvista")
    series = PvdSeries(tmp_path / "run.pvd")
    assert series.entries() == []
    times = [0.0, 0.1, 1 / 3]
    for number, time in enumerate(times):
        frame(tmp_path / f"frame {number} & more.vtu", degree=2, time=time)
        series.append(time, f"frame {number} & more.vtu")
        # readable after every frame
        assert pv.get_reader(tmp_path / "run.pvd").time_values == times[: number + 1]
    reader = pv.get_reader(tmp_path / "run.pvd")
    reader.set_active_time_value(times[1])
    np.testing.assert_array_equal(reader.read()[0].points, frame(tmp_path / "b.vtu", 2)[1])
    with pytest.raises(ValueError, match="lists 3 frames; 4 were written"):
        series.keep(4)
    assert series.keep(2) == ["frame 2 & more.vtu"]
    assert series.entries() == [(0.0, "frame 0 & more.vtu"), (0.1, "frame 1 & more.vtu")]


def test_pvd_that_is_not_ours_is_refused(tmp_path):
    path = tmp_path / "run.pvd"
    bomb = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "bbbb">]><VTKFile>&b;</VTKFile>'
    for text in ("", "no xml", bomb, "<VTKFile><DataSet/></VTKFile>"):
        path.write_text(text)
        with pytest.raises(ValueError, match="not a list of frames"):
            PvdSeries(path).entries()

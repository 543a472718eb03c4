"""Frames of our runs and surfaces of other libraries, read or refused with the way to pass them."""

import base64
import pathlib
import re
import types
import zlib

import numpy as np
import pytest

from jaxwillmore.io import read_surface, write_vtu
from jaxwillmore.mesh import SurfaceError, ellipsoid

from .surfaces import ball

V, F = ball(1)
FRAME = pathlib.Path(__file__).parent / "data" / "frames" / "icosahedron.vtu"


# 1. Frames.
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_a_frame_is_read_as_it_was_computed(tmp_path, degree):
    mesh, x = ellipsoid((1.0, 1.2, 2.0), level=1, degree=degree)
    write_vtu(tmp_path / "a.vtu", mesh, x, {"H": x[:, 0]}, time=0.5)
    again, y = read_surface(tmp_path / "a.vtu")
    assert again.degree == degree
    np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(mesh.cells, again.cells)


def test_a_frame_of_an_earlier_version_is_read():
    mesh, _ = read_surface(FRAME)
    assert mesh.euler_characteristic == 2


def test_large_frames_of_many_blocks_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr("jaxwillmore.io._vtu._BLOCK", 1000)
    mesh, x = ellipsoid(level=2, degree=2)
    write_vtu(tmp_path / "a.vtu", mesh, x)
    np.testing.assert_array_equal(read_surface(tmp_path / "a.vtu")[1], x)


TEXT = FRAME.read_text()
NOTHING = base64.b64encode(bytes(24)).decode()


def block(content, claimed):
    """An array of one block that claims to unpack to so many bytes."""
    packed = zlib.compress(content)
    counts = np.array([1, claimed, claimed, len(packed)], "<u8").tobytes()
    return (base64.b64encode(counts) + base64.b64encode(packed)).decode()


def with_array(name, text):
    return re.sub(rf'(Name="{name}"[^>]*>\n)[^<]*', rf"\g<1>{text}\n", TEXT)


def with_points(text):
    return with_array("Points", text)


BAD_FRAMES = {
    "appended arrays": (TEXT.replace('format="binary"', 'format="appended"'), "PolyData|pyvista"),
    "a poly data file": (TEXT.replace("UnstructuredGrid", "PolyData"), "no unstructured grid"),
    "entities": ("<!DOCTYPE a [<!ENTITY b 'c'>]>" + TEXT, "entities"),
    "cut": (TEXT[: len(TEXT) // 2], "truncated"),
    "no points": (with_points(NOTHING), "only 0 nodes"),
    "other letters": (with_points("§§§§"), "damaged"),
    "a bomb": (with_points(block(bytes(2**27), 2**27)), "more than is announced"),
    "a lie": (with_points(block(bytes(2**16), 8)), "more than is announced"),
    "tetrahedra": (with_array("types", block(b"\n" * 20, 20)), "triangles of one degree"),
    "text": ("<VTKFile", "damaged"),
}  # fmt: skip


def test_numbers_too_large_for_their_type_are_named_by_the_check(tmp_path):
    points = " ".join(["1e308"] * 126)
    text = re.sub(
        r'<DataArray type="Float64" Name="Points"[^>]*>[^<]*',
        f'<DataArray type="Float32" Name="Points" format="ascii">{points}',
        TEXT,
    )
    (tmp_path / "a.vtu").write_text(text)
    with pytest.raises(SurfaceError, match="non_finite"):
        read_surface(tmp_path / "a.vtu")


@pytest.mark.parametrize("what", BAD_FRAMES)
def test_other_frames_are_refused_in_words(tmp_path, what):
    content, words = BAD_FRAMES[what]
    (tmp_path / "a.vtu").write_text(content, encoding="utf-8")
    with pytest.raises(SurfaceError, match=rf"(?s)a\.vtu.*({words})"):
        read_surface(tmp_path / "a.vtu")


def test_triangles_in_frames_of_other_programs_are_read_and_cubes_are_not(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    surface = pyvista.PolyData.from_regular_faces(V, F)
    surface.cast_to_unstructured_grid().save(tmp_path / "a.vtu")
    np.testing.assert_array_equal(read_surface(tmp_path / "a.vtu")[1], V)
    pyvista.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid().save(tmp_path / "a.vtu")
    with pytest.raises(SurfaceError, match="extract_surface"):
        read_surface(tmp_path / "a.vtu")


# 2. Objects.
def test_pyvista_surfaces_are_read():
    pyvista = pytest.importorskip("pyvista")
    surface = pyvista.PolyData.from_regular_faces(V, F)
    mesh, x = read_surface(surface)
    np.testing.assert_array_equal(x, V)
    np.testing.assert_array_equal(mesh.cells, F)
    with pytest.raises(SurfaceError, match="triangulate"):
        read_surface(pyvista.Cube())
    np.testing.assert_array_equal(read_surface(surface.cast_to_unstructured_grid())[1], V)
    cubes = pyvista.ImageData(dimensions=(3, 3, 3))
    with pytest.raises(TypeError, match="extract_surface"):
        read_surface(cubes)
    with pytest.raises(TypeError, match="triangles alone"):
        read_surface(cubes.cast_to_unstructured_grid())


def test_meshio_surfaces_are_read():
    meshio = pytest.importorskip("meshio")
    np.testing.assert_array_equal(read_surface(meshio.Mesh(V, [("triangle", F)]))[1], V)
    with pytest.raises(TypeError, match="triangles alone"):
        read_surface(meshio.Mesh(V, [("triangle", F), ("line", F[:, :2])]))


def test_marching_cubes_are_read_as_they_come():
    _, x = read_surface((V, F, np.zeros_like(V), np.zeros(len(V))))
    np.testing.assert_array_equal(x, V)


def test_surfaces_with_triangles_are_read():
    _, x = read_surface(types.SimpleNamespace(vertices=V, triangles=F))  # as open3d
    np.testing.assert_array_equal(x, V)


def test_scenes_are_refused_with_the_way():
    import trimesh

    with pytest.raises(TypeError, match=r"geometry\.values"):
        read_surface(trimesh.Scene([trimesh.Trimesh(V, F, process=False)]))

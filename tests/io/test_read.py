"""Reading surfaces: every format gives the same surface, units do not matter, and bad input ends
in an error that names what and where."""

import contextlib
import re

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.io import SurfaceWarning, read_surface, write_npz, write_ply
from jaxwillmore.mesh import SurfaceError, ellipsoid, icosphere, torus

from .surfaces import (
    ball,
    obj_text,
    off_text,
    ply_bytes,
    ply_header,
    ply_text,
    rows,
    stl_bytes,
    stl_text,
)

V, F = ball(1)


def put(folder, name, content):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def npz(folder, name="a.npz", **arrays):
    np.savez(folder / name, **arrays)
    return folder / name


# 1. Good files in every format.
EXACT = {
    "a.off": off_text(V, F),
    "colours.off": off_text(V, F).replace("OFF", "COFF # hi", 1).replace(" 0.0\n", " 0.0 9 9 9\n"),
    "a.obj": obj_text(V, F),
    "upper.OBJ": obj_text(V, F),
    "seams.obj": "mtllib ../../../etc/passwd\nvt 0 0\nvn 0 0 1\n"
    + re.sub(r"(?m)^f (\d+) (\d+) (\d+)$", r"f \1/1/1 \2/1/1 \3//1", obj_text(V, F)),
    "negative.obj": "\n".join(["v " + r for r in rows(V)] + ["f " + r for r in rows(F - len(V))]),
    "latin.obj": b"# caf\xe9\n" + obj_text(V, F).encode(),
    "text.ply": ply_text(V, F),
    "latin.ply": ply_text(V, F).encode().replace(b"element v", b"comment caf\xe9\nelement v"),
    "little.ply": ply_bytes(V, F),
    "big.ply": ply_bytes(V, F, ">"),
    "windows.off": off_text(V, F).replace("\n", "\r\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", EXACT)
def test_text_and_double_formats_are_read_exactly(tmp_path, name):
    mesh, x = read_surface(put(tmp_path, name, EXACT[name]))
    assert mesh.degree == 1 and x.dtype == jnp.float64
    np.testing.assert_array_equal(x, V)
    np.testing.assert_array_equal(mesh.cells, F)


@pytest.mark.parametrize("content", [stl_bytes(V, F), stl_text(V, F)], ids=["binary", "text"])
def test_stl_becomes_the_same_closed_surface(tmp_path, content):
    mesh, x = read_surface(put(tmp_path, "a.stl", content))
    assert (mesh.n_nodes, mesh.euler_characteristic) == (len(V), 2)
    np.testing.assert_allclose(np.array(x)[np.array(mesh.cells)], V[F], atol=1e-7)


def test_trimesh_and_arrays_are_read_and_not_changed():
    import trimesh

    source = trimesh.Trimesh(V, F, process=False)
    for mesh, x in (
        read_surface(source),
        read_surface((V, F)),
        read_surface((V.tolist(), F.tolist())),
    ):
        np.testing.assert_array_equal(x, V)
        np.testing.assert_array_equal(mesh.cells, F)
    np.testing.assert_array_equal(source.vertices, V)


@pytest.mark.parametrize(
    "v, f",
    [
        (V.astype(">f8"), F.astype(">i4")),
        (np.asfortranarray(V), F[:, ::1].astype(np.uint8)),
        (V.copy(), F.astype(float)),
    ],
    ids=["big-endian", "fortran-uint8", "whole-floats"],
)
def test_odd_memory_layouts_are_read(v, f):
    v.flags.writeable = f.flags.writeable = False
    mesh, x = read_surface((v, f))
    np.testing.assert_array_equal(x, V)
    np.testing.assert_array_equal(mesh.cells, F)


@pytest.mark.filterwarnings("ignore::jaxwillmore.io.SurfaceWarning")  # these meshes are coarse
@pytest.mark.parametrize("size", [5e-8, 1e-9, 1.0, 1e11, 1e12])
@pytest.mark.parametrize("name", ["a.off", "a.obj", "a.ply"])
def test_the_unit_of_length_does_not_matter(tmp_path, name, size):
    text = {"a.off": off_text, "a.obj": obj_text, "a.ply": ply_text}[name](size * V, F)
    path = put(tmp_path, name, text)
    extreme = pytest.warns(SurfaceWarning, match="extreme_scale")
    with contextlib.nullcontext() if size == 1.0 else extreme:
        mesh, x = read_surface(path, degree=2)
    assert mesh.euler_characteristic == 2
    np.testing.assert_array_equal(x[: len(V)], size * V)
    unit = read_surface((V, F), degree=2)[1]
    np.testing.assert_allclose(np.array(x) / size, unit, atol=1e-12)


@pytest.mark.filterwarnings("ignore::jaxwillmore.io.SurfaceWarning")  # these meshes are coarse
def test_new_nodes_lie_on_a_curved_surface_not_on_the_facets():
    _, x = read_surface(ball(2), degree=2)
    _, flat = icosphere(2, degree=2)
    assert np.abs(np.linalg.norm(x, axis=1) - 1).max() < 1e-3  # midpoints of facets: 1e-2
    assert x.shape == flat.shape


# 2. Surfaces of higher degree, in our own format.
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_npz_keeps_a_surface_of_any_degree_exactly(tmp_path, degree):
    mesh, x = ellipsoid((1.0, 1.0, 2.0), level=1, degree=degree)
    write_npz(tmp_path / "a.npz", mesh, x, {"H": x[:, 0]})
    again, y = read_surface(tmp_path / "a.npz")
    np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(mesh.cells, again.cells)
    assert again.degree == degree


def test_raising_the_degree_of_a_curved_surface_does_not_move_it(tmp_path):
    mesh, x = torus(level=1, degree=2)
    write_npz(tmp_path / "a.npz", mesh, x)
    high, y = read_surface(tmp_path / "a.npz", degree=4)
    assert high.degree == 4
    write_npz(tmp_path / "b.npz", high, y)
    _, back = read_surface(tmp_path / "b.npz", degree=2)
    np.testing.assert_allclose(back, x, atol=1e-14)


def test_foreign_npz_with_vertices_and_faces_is_read(tmp_path):
    mesh, x = read_surface(npz(tmp_path, vertices=V, faces=F.astype(np.int32), extra=np.ones(3)))
    np.testing.assert_array_equal(x, V)


def test_ply_of_a_curved_surface_is_its_fine_triangles(tmp_path):
    mesh, x = icosphere(1, degree=3)
    write_ply(tmp_path / "a.ply", mesh, x, {"H": x[:, 0], "normal": x, "velocity": 2 * x})
    flat, y = read_surface(tmp_path / "a.ply")
    np.testing.assert_array_equal(x, y)
    assert (flat.n_cells, flat.euler_characteristic) == (9 * mesh.n_cells, 2)
    import trimesh

    other = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(other.vertices, x)
    assert other.is_watertight and other.volume > 0
    raw = other.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(raw["H"], x[:, 0])
    np.testing.assert_array_equal(raw["nz"], x[:, 2])
    np.testing.assert_array_equal(raw["velocity_y"], 2 * x[:, 1])


# 3. Repairs, only when asked for.
def soup(noise=0.0):
    corners = V[F].reshape(-1, 3)
    noise = noise * np.random.default_rng(0).uniform(-1, 1, corners.shape)
    return corners + noise, np.arange(len(corners)).reshape(-1, 3)


def test_a_soup_is_merged_on_request_and_else_refused():
    with pytest.raises(SurfaceError, match="merge_tolerance"):
        read_surface(soup())
    with pytest.warns(SurfaceWarning, match="repaired: made one .* 198 fewer"):
        mesh, x = read_surface(soup(), merge_tolerance=0.0)
    assert mesh.n_nodes == len(V)
    with pytest.raises(SurfaceError, match="merge_tolerance"):
        read_surface(soup(1e-7))
    with pytest.warns(SurfaceWarning, match="repaired"):
        mesh, x = read_surface(soup(1e-7), merge_tolerance=1e-6)
    assert (mesh.n_nodes, mesh.euler_characteristic) == (len(V), 2)


def test_the_advice_about_a_soup_can_be_followed(tmp_path):
    with pytest.raises(SurfaceError) as caught:
        read_surface(soup(1e-7))
    numbers = re.findall(r"merge_tolerance=([-+.0-9e]+[0-9])", str(caught.value))
    with pytest.warns(SurfaceWarning, match="repaired"):
        mesh, _ = read_surface(soup(1e-7), merge_tolerance=float(numbers[0]))
    assert mesh.n_nodes == len(V)


@pytest.mark.parametrize("which", ["one", "all", "random"])
def test_orientation_is_fixed_on_request_and_else_refused(which):
    turn = {
        "one": np.arange(len(F)) == 7,
        "all": np.ones(len(F), bool),
        "random": np.random.default_rng(1).uniform(size=len(F)) < 0.5,
    }[which]
    faces = np.where(turn[:, None], F[:, ::-1], F)
    with pytest.raises(SurfaceError):
        read_surface((V, faces))
    with pytest.warns(SurfaceWarning, match="turned faces over"):
        mesh, x = read_surface((V, faces), fix_orientation=True)
    a, b, c = np.moveaxis(np.array(x)[np.array(mesh.cells)], 1, 0)
    assert np.sum(a * np.cross(b, c)) > 0


def test_a_moebius_band_of_repairs_is_still_refused():
    # six vertices of the projective plane: closed, but no orientation exists
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 1]]
    faces += [[1, 2, 4], [2, 3, 5], [3, 4, 1], [4, 5, 2], [5, 1, 3]]
    vertices = np.random.default_rng(0).normal(size=(6, 3))
    with pytest.raises(SurfaceError):
        read_surface((vertices, np.array(faces)), fix_orientation=True)


# 4. Bad input. (what, builder, words the message must hold)
def changed(array, index, value):
    array = np.array(array, dtype=float if isinstance(value, float) else None)
    array[index] = value
    return array


def two(shift, scale=1.0):
    inner = scale * V[:, :] + shift
    return np.concatenate([V, inner]), np.concatenate([F, F + len(V)])


ARRAYS = {
    "nan": (lambda: (changed(V, (5, 1), np.nan), F), r"finite.*5"),
    "inf": (lambda: (changed(V, (7, 0), np.inf), F), r"finite.*7"),
    "hole": (lambda: (V, F[1:]), r"open|boundary"),
    "flipped face": (lambda: (V, changed(F, 3, F[3, ::-1])), r"orient"),
    "inside out": (lambda: (V, F[:, ::-1]), r"inward|orient|outward"),
    "index out of range": (lambda: (V, changed(F, (4, 0), 99)), r"face 4 names 99"),
    "negative index": (lambda: (V, changed(F, (4, 0), -1)), r"face 4 names -1"),
    "fractional faces": (lambda: (V, F + 0.4), r"integers"),
    "empty": (lambda: (np.zeros((0, 3)), np.zeros((0, 3), int)), r"no vertices"),
    "no faces": (lambda: (V, np.zeros((0, 3), int)), r"no faces"),
    "2-D vertices": (lambda: (V[:, :2], F), r"\(42, 2\)"),
    "quads": (lambda: (V, np.concatenate([F, F[:, :1]], axis=1)), r"quadrilateral"),
    "repeated corner": (lambda: (V, changed(F, (3, 0), F[3, 1])), r"3"),
    "duplicate face": (lambda: (V, np.concatenate([F, F[:1]])), r"duplicate"),
    "unused vertex": (lambda: (np.concatenate([V, [[9.0, 9, 9]]]), F), r"42"),
    "two spheres": (lambda: two(np.array([5.0, 0, 0])), r"component|pieces"),
    "nested spheres": (lambda: two(np.zeros(3), 0.5), r"component|pieces|nested"),
    "complex": (lambda: (V + 0j, F), r"complex"),
    "strings": (lambda: (V.astype(str), F), r"numbers"),
    "masked": (lambda: (np.ma.masked_array(V, V > 0.99), F), r"masked"),
    "None": (lambda: (None, None), r"numbers|array"),
    "ragged": (lambda: ([[0, 0, 0], [1, 0]], [[0, 1, 2]]), r"array"),
    "objects": (lambda: (V.astype(object), F), r"object"),
    "uint8 wrapped": (lambda: ((b := ball(3))[0], b[1].astype(np.uint8)), r"wrapped"),
    "spheres sharing a vertex": (
        lambda: (
            np.concatenate([V, np.delete(2 * V[0] - V, 0, axis=0)]),
            np.concatenate([F, np.where(F[:, ::-1] > 0, F[:, ::-1] + len(V) - 1, 0)]),
        ),
        r"vert",
    ),
}


@pytest.mark.parametrize("what", ARRAYS)
def test_bad_arrays_are_refused_with_a_reason(what):
    build, words = ARRAYS[what]
    with pytest.raises(SurfaceError) as caught:
        read_surface(build())
    assert re.search(words, str(caught.value), re.S | re.I), str(caught.value)


OFF, OBJ, PLY, STL = off_text(V, F), obj_text(V, F), ply_text(V, F), stl_bytes(V, F)
NOISE = np.random.default_rng(3).bytes(3000)
HUGE_PLY = ply_bytes(V, F).replace(b"x 42", b"x 4000000000")
QUAD_OFF = "OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
QUAD_OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
FACE = "3 " + rows(F)[0]
FIFTH = rows(V)[4]
QUAD_PLY = ply_header(4, 1) + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
MIXED = ply_header(4, 3, "binary_little_endian").encode() + np.zeros(12).tobytes()
for n in (3, 4, 2):  # as long as three triangles
    MIXED += bytes([n]) + np.arange(n, dtype="<i4").tobytes()

FILES = {
    "empty stl": ("a.stl", "", "empty"),
    "empty obj": ("a.obj", "", "empty"),
    "empty off": ("a.off", "", "empty"),
    "empty ply": ("a.ply", "", "empty"),
    "blank obj": ("a.obj", "\n\n", "0 vertices"),
    "blank off": ("a.off", "\n\n", "OFF"),
    "stl without triangles": ("a.stl", b"\0" * 84, "no triangles"),
    "truncated off": ("a.off", "\n".join(OFF.split("\n")[:31]), "announces 42 .* 29"),
    "truncated off header": ("a.off", "OFF\n", "truncated"),
    "truncated obj": ("a.obj", OBJ[: OBJ.rindex("f") - 5], "line|open|boundary"),
    "truncated text ply": ("a.ply", PLY[: len(PLY) * 3 // 4], "announces 80|corners|vertices"),
    "truncated ply vertices": ("a.ply", PLY[: len(PLY) // 4], "coordinates|announces 42"),
    "truncated binary ply": ("a.ply", ply_bytes(V, F)[:-7], "announces 80 .* holds 79"),
    "truncated ply header": ("a.ply", PLY[:40], "header does not end"),
    "truncated stl": ("a.stl", STL[:-30], "truncated"),
    "truncated text stl": ("a.stl", stl_text(V, F)[:-60], "truncated"),
    "random stl": ("a.stl", NOISE, "STL"),
    "random obj": ("a.obj", NOISE, "binary"),
    "random off": ("a.off", NOISE, "binary"),
    "random ply": ("a.ply", NOISE, "PLY"),
    "random npz": ("a.npz", NOISE, "archive"),
    "text as obj": ("a.obj", "lorem ipsum dolor", "0 vertices"),
    "huge count ply": ("a.ply", PLY.replace("vertex 42", "vertex 4000000000"), "4000000000"),
    "huge count binary ply": ("a.ply", HUGE_PLY, "4000000000"),
    "huge count off": ("a.off", OFF.replace("42 80 0", "4000000000 80 0"), "4000000000"),
    "huge count stl": ("a.stl", STL[:80] + b"\xff" * 4 + STL[84:], "STL"),
    "obj with nan": ("a.obj", OBJ.replace("v " + FIFTH, "v nan 0 1"), "finite.*4"),
    "off with nan": ("a.off", OFF.replace(FIFTH, "0 nan 1"), "finite.*4"),
    "off with inf": ("a.off", OFF.replace(FIFTH, "0 1e999 1"), "finite.*4"),
    "ply with nan": ("a.ply", PLY.replace(FIFTH, "0 nan 1"), "finite.*4"),
    "binary ply with nan": ("a.ply", ply_bytes(changed(V, (4, 0), np.nan), F), "finite.*4"),
    "stl with nan": ("a.stl", stl_bytes(changed(V, (4, 0), np.nan), F), "finite"),
    "obj index 0": ("a.obj", OBJ + "f 0 1 2\n", "line 123.*count from 1"),
    "obj index n + 1": ("a.obj", OBJ + "f 1 2 43\n", "line 123.*has 42"),
    "obj index beyond int64": ("a.obj", OBJ + "f 1 2 99999999999999999999999\n", "line 123"),
    "off index beyond int64": ("a.off", OFF.replace(FACE, "3 1 2 9" + 30 * "9"), "vertex 999"),
    "off index out of range": ("a.off", OFF.replace(FACE, "3 1 2 77"), "face 0 names 77"),
    "off float index": ("a.off", OFF.replace(FACE, "3 1 2 0.4"), "line 45"),
    "ply float index": ("a.ply", PLY.replace(FACE, "3 1 2 0.4"), "line 52"),
    "obj decimal commas": ("a.obj", OBJ.replace("v " + FIFTH, "v 0,5 0,5 1"), "line 5.*commas"),
    "off decimal commas": ("a.off", OFF.replace(FIFTH, "0,5 0,5 1"), "line 7.*commas"),
    "ply decimal commas": ("a.ply", PLY.replace(FIFTH, "0,5 0,5 1"), "line 14.*commas"),
    "stl decimal commas": ("a.stl", stl_text(V, F).replace(".", ","), "commas"),
    "off words": ("a.off", OFF.replace(FIFTH, "a b c"), "line 7"),
    "off goes on": ("a.off", OFF + "3 0 1 2\n", "goes on"),
    "quads off": ("a.off", QUAD_OFF, "line 7.*4 corners.*triangulate"),
    "quads obj": ("a.obj", QUAD_OBJ, "line 5.*4 corners.*triangulate"),
    "quads ply": ("a.ply", QUAD_PLY, "4 corners.*triangulate"),
    "mixed binary ply": ("a.ply", MIXED, "face 1 has 4 corners.*triangulate"),
    "stl holding ply": ("a.stl", PLY, "PLY.*rename it to `a.ply`"),
    "ply holding stl": ("a.ply", STL, "STL.*a.stl"),
    "obj holding off": ("a.obj", OFF, "OFF.*a.off"),
    "off holding obj": ("a.off", OBJ, "OBJ.*a.obj"),
    "unknown type": ("a.txt", OFF, r"\.ply, \.off"),
    "no extension": ("a", OFF, r"\.ply, \.off"),
    "ply points only": ("a.ply", PLY[: PLY.index("element face")] + "end_header\n0 0 0\n", "faces"),
    "4-D off": ("a.off", OFF.replace("OFF", "4OFF"), "OFF"),
}  # fmt: skip


@pytest.mark.parametrize("what", FILES)
def test_bad_files_are_refused_with_name_and_reason(tmp_path, what):
    name, content, words = FILES[what]
    path = put(tmp_path, name, content)
    with pytest.raises(SurfaceError) as caught:
        read_surface(path)
    message = str(caught.value)
    assert str(path) in message
    assert re.search(words, message, re.S), message


@pytest.mark.parametrize("name", ["a.off", "a.obj", "a.ply", "b.ply", "a.stl", "b.stl", "a.npz"])
def test_no_damage_to_a_file_ends_in_anything_but_a_surface_error(tmp_path, name):
    npz(tmp_path, "good.npz", vertices=V, faces=F)
    good = {
        "a.off": OFF.encode(),
        "a.obj": OBJ.encode(),
        "a.ply": PLY.encode(),
        "b.ply": ply_bytes(V, F),
        "a.stl": STL,
        "b.stl": stl_text(V, F).encode(),
        "a.npz": (tmp_path / "good.npz").read_bytes(),
    }[name]
    rng = np.random.default_rng(5)
    for trial in range(60):
        bad = bytearray(good)
        if trial % 3 == 0:
            del bad[rng.integers(len(bad)) :]
        else:
            for _ in range(1 + trial % 5):
                bad[rng.integers(min(len(bad), 10 ** (2 + trial % 3)))] = rng.integers(256)
        path = put(tmp_path, name, bytes(bad))
        try:
            mesh, x = read_surface(path)
        except SurfaceError as error:
            assert str(path) in str(error)
        except SurfaceWarning:
            pass
        else:
            assert mesh.euler_characteristic == 2 and np.all(np.isfinite(x))


def test_missing_files_and_folders(tmp_path):
    put(tmp_path, "cell.ply", PLY)
    with pytest.raises(FileNotFoundError, match="Did you mean .*cell.ply"):
        read_surface(tmp_path / "cel.ply")
    with pytest.raises(FileNotFoundError, match="no file"):
        read_surface(tmp_path / "nowhere" / "a.ply")
    with pytest.raises(IsADirectoryError, match="folder"):
        read_surface(tmp_path)


def test_sizes_are_capped_before_reading(tmp_path):
    with pytest.raises(SurfaceError, match="max_bytes"):
        read_surface(put(tmp_path, "a.off", OFF), max_bytes=100)
    np.savez_compressed(tmp_path / "bomb.npz", vertices=np.zeros((10**6, 3)), faces=F)
    assert (tmp_path / "bomb.npz").stat().st_size < 10**5
    with pytest.raises(SurfaceError, match="unpacks to 24"):
        read_surface(tmp_path / "bomb.npz", max_bytes=10**6)


def test_npz_files_that_are_not_surfaces(tmp_path):
    with pytest.raises(SurfaceError, match="it holds \\['a'\\]"):
        read_surface(npz(tmp_path, a=np.ones(3)))
    with pytest.raises(SurfaceError, match="Python objects"):
        read_surface(npz(tmp_path, vertices=np.array([None, {}]), faces=F))
    with pytest.raises(SurfaceError, match="3, 6, 10 or 15"):
        read_surface(npz(tmp_path, x=V, cells=np.zeros((4, 5), int)))
    mesh, x = icosphere(1, degree=2)
    with pytest.raises(SurfaceError, match="edge"):  # nodes out of order
        read_surface(
            npz(
                tmp_path, x=x, cells=np.roll(np.array(mesh.cells), 1, axis=0)[:, [0, 1, 2, 4, 5, 3]]
            )
        )
    with pytest.raises(SurfaceError, match="(?s)inverted"):
        read_surface(npz(tmp_path, x=x.at[mesh.n_vertices].multiply(-1.0), cells=mesh.cells))
    with pytest.raises(SurfaceError, match="finite"):
        read_surface(npz(tmp_path, x=x.at[-1].multiply(jnp.nan), cells=mesh.cells))


@pytest.mark.parametrize("source", [3, None, (V,), {"v": V}, np.zeros(3)])
def test_sources_of_another_kind_are_a_type_error(source):
    with pytest.raises(TypeError, match="path"):
        read_surface(source)


@pytest.mark.parametrize("degree", [0, 5, True])
def test_degrees_out_of_range_are_refused(degree):
    with pytest.raises(ValueError, match="1, 2, 3 or 4"):
        read_surface((V, F), degree=degree)


@pytest.mark.parametrize("tolerance", [-1.0, float("nan"), float("inf")])
def test_merge_tolerance_must_be_a_length(tolerance):
    with pytest.raises(ValueError, match="merge_tolerance"):
        read_surface((V, F), merge_tolerance=tolerance)


def test_far_from_the_origin_is_a_warning():
    with pytest.warns(SurfaceWarning, match="(?s)origin"):
        read_surface((V + 1e8, F))


def test_single_precision_arrays_are_a_warning_and_used_in_double():
    with pytest.warns(SurfaceWarning, match="single_precision"):
        _, x = read_surface((V.astype(np.float32), F))
    assert x.dtype == jnp.float64
    np.testing.assert_array_equal(x, V.astype(np.float32))


def test_expected_genus_and_components():
    mesh, x = torus(level=1, degree=1)
    with pytest.raises(SurfaceError, match="genus"):
        read_surface((x, mesh.cells), genus=0)
    v, f = two(np.array([5.0, 0, 0]))
    assert read_surface((v, f), components=2)[0].n_nodes == 2 * len(V)


def test_no_other_file_is_opened(tmp_path):
    """Material and texture files named in a mesh are never touched."""
    import sys

    opened = []
    text = "mtllib /etc/hostname\nmtllib ../secret.mtl\nusemtl a\n" + OBJ
    path = put(tmp_path, "a.obj", text)
    sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
    read_surface(path)
    outside = [name for name in opened if "hostname" in name or name.endswith("mtl")]
    assert not outside and str(path) in opened

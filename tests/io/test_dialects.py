"""What other programs write: every dialect of a format is the same surface, and what is not a
surface is refused for the right reason, in one line."""

import io
import os
import pathlib
import re
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from jaxwillmore.io import read_surface
from jaxwillmore.mesh import SurfaceError, check_mesh

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

V, F = ball(0)
DATA = pathlib.Path(__file__).parent / "data"
BOM = b"\xef\xbb\xbf"
OFF, OBJ, PLY, STL = off_text(V, F), obj_text(V, F), ply_text(V, F), stl_text(V, F)


def put(folder, name, content):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def with_signalling_nan(data, at):
    """One number in single precision that is no number, and traps when it is converted."""
    return data[:at] + b"\x01\0\xa0\x7f" + data[at + 4 :]


def two_solids():
    """Half of the faces each; only both together are closed."""
    return stl_text(V, F[:9]) + stl_text(V, F[9:]).replace("ball", "rest")


def wedge(text, order="<"):
    """Faces with a second list of 0, 2 or 6 entries before the corners or behind them."""
    kind = "ascii" if text else "binary_little_endian"
    head = ply_header(len(V), len(F), kind) if text else ply_header(len(V), len(F), kind)
    head = head.replace("end_header", "property list uchar float texcoord\nend_header")
    sizes = [(0, 2, 6)[n % 3] for n in range(len(F))]
    if text:
        lines = [f"3 {r} {n} {'0.5 ' * n}" for r, n in zip(rows(F), sizes, strict=True)]
        return head + "\n".join([*rows(V), *lines, ""])
    packed = [
        struct.pack("<B3iB", 3, *f, n) + struct.pack(f"<{n}f", *([0.5] * n))
        for f, n in zip(F.tolist(), sizes, strict=True)
    ]
    return head.encode() + V.astype("<f8").tobytes() + b"".join(packed)


def listed_vertices(text):
    """Vertices with a list of neighbours in front of their coordinates."""
    head = ply_header(len(V), len(F), "ascii" if text else "binary_little_endian")
    head = head.replace("property double x", "property list uchar int near\nproperty double x")
    sizes = [n % 3 for n in range(len(V))]
    if text:
        lines = [f"{n} {'7 ' * n}{r}" for n, r in zip(sizes, rows(V), strict=True)]
        return head + "\n".join([*lines, *("3 " + r for r in rows(F)), ""])
    packed = [
        struct.pack(f"<B{n}i3d", n, *([7] * n), *p) for n, p in zip(sizes, V.tolist(), strict=True)
    ]
    faces = [struct.pack("<B3i", 3, *f) for f in F.tolist()]
    return head.encode() + b"".join([*packed, *faces])


def one_line(text):
    return " ".join(text.split())


DIALECTS = {
    "mark.obj": BOM + OBJ.encode(),
    "mark.off": BOM + OFF.encode(),
    "mark.ply": BOM + PLY.encode(),
    "mark.stl": BOM + STL.encode(),
    "joined.off": OFF.replace("OFF\n", "OFF"),
    "counts_in_first_line.off": OFF.replace("OFF\n", "OFF "),
    "one_line.off": one_line(OFF),
    "one_number_per_line.off": OFF.replace(" ", "\n"),
    "no_edges.off": OFF.replace("12 20 0", "12 20"),
    "blanks.off": OFF.replace("\n", " \n\n"),
    "face_colours.off": re.sub(r"(?m)^(3 .*)$", r"\1 0.1 0.2 0.3", OFF),
    "vertex_colours.off": re.sub(r"(?m)^([^ ]+\.[^ ]* .*)$", r"\1 255 0 0 255", OFF),
    "coff_one_line.off": one_line(
        re.sub(r"(?m)^([^ ]+\.[^ ]* .*)$", r"\1 255 0 0 255", OFF.replace("OFF", "COFF"))
    ),
    "colours_twice.ply": PLY,
    "windows_header.ply": ply_bytes(V, F).replace(b"\n", b"\r\n", 9),
    "comment_end_header.ply": PLY.replace("element v", "comment end_header is below\nelement v"),
    "edges_behind.ply": PLY.replace("end_h", "element edge 1\nproperty int a\nend_h") + "0\n",
    "material_first.ply": PLY.replace(
        "element vertex", "element material 1\nproperty int a\nelement vertex"
    ).replace("end_header\n", "end_header\n4\n"),
    "uneven_lists_text.ply": wedge(text=True),
    "uneven_lists.ply": wedge(text=False),
    "lists_in_vertices_text.ply": listed_vertices(text=True),
    "lists_in_vertices.ply": listed_vertices(text=False),
    "negative.obj": "\n".join(["v " + r for r in rows(V)] + ["f " + r for r in rows(F - len(V))]),
    "blanks_in_front.stl": "  " + STL,
    "upper.stl": STL.upper(),
    "two_solids.stl": two_solids(),
    "named_like_a_facet.stl": STL.replace("ball", "vertex facet endfacet"),
    "normals_of_old_compilers.stl": STL.replace("normal 0 0 0", "normal -1.#IND nan? 0", 1),
    "solid_in_front.stl": b"solid facet" + stl_bytes(V, F)[11:],
    "trailing_bytes.stl": stl_bytes(V, F) + b"\r\n",
}  # fmt: skip


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_is_the_same_surface(tmp_path, name, capfd):
    mesh, x = read_surface(put(tmp_path, name, DIALECTS[name]))
    report = check_mesh(mesh, x)
    right = check_mesh(*read_surface((V, F)))
    assert (mesh.n_nodes, mesh.n_cells) == (len(V), len(F))
    assert report.area == pytest.approx(right.area, rel=1e-7)  # STL may hold single precision
    assert report.volume == pytest.approx(right.volume, rel=1e-7)
    assert capfd.readouterr() == ("", "")


HUGE = "9" * 5000
LITTLE = ply_bytes(V, F)
BOMB = io.BytesIO()
with zipfile.ZipFile(BOMB, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as out:
    np.lib.format.write_array_header_1_0(
        out, {"descr": "<f8", "fortran_order": False, "shape": (2**22, 3)}
    )
    for _ in range(3 * 32):
        out.write(bytes(2**20))


def with_list(count, value, type="char"):
    """Faces whose additional list has `value` as the number of its entries."""
    text = LITTLE.replace(
        b"property list uchar", f"property list {type} float extra\nproperty list uchar".encode()
    )
    at = text.index(b"end_header\n") + 11 + V.nbytes
    return text[:at] + struct.pack(count, value) + text[at:]


REFUSED = {
    "utf16.obj": (OBJ.encode("utf-16"), "UTF-16.*iconv"),
    "utf16.ply": (PLY.encode("utf-16"), "UTF-16"),
    "utf16_without_mark.off": (OFF.encode("utf-16-le"), "UTF-16"),
    "utf32.stl": (STL.encode("utf-32"), "UTF-32"),
    "binary.off": ("OFF BINARY\n12 20 0\n", "binary OFF"),
    "cut_free.off": (one_line(OFF)[:-30], "announces 20 faces.*truncated"),
    "colours_free.off": (one_line(DIALECTS["face_colours.off"]), "line of its own"),
    "count_of_5000_digits.off": (OFF.replace("12 20", HUGE + " 20"), "5000 char.*number of vert"),
    "count_of_5000_digits.ply": (PLY.replace("vertex 12", "vertex " + HUGE), "5000 characters"),
    "corners_of_5000_digits.ply": (PLY.replace("\n3 ", f"\n{HUGE} ", 1), "5000 characters"),
    "corner_of_4000_digits.off": (OFF.replace("3 0 ", f"3 {HUGE[:4000]} ", 1), "vertex 99"),
    "underscores_in_face.obj": (OBJ.replace("f ", "f 0_", 1), "vertex numbers"),
    "underscores_in_vertex.obj": (OBJ.replace("v ", "v 1_0 ", 1), "line 1: '1_0 .* not a point"),
    "quads.obj": ("v 0 0 0\n" * 4 + "f 1 2 3 4\n", "line 5: .*4 corners.*triangulate"),
    "float_count.ply": (
        LITTLE.replace(b"list uchar", b"list float"),
        "length of the list 'vertex_indices'.*float.*whole numbers",
    ),
    "negative_list.ply": (with_list("<b", -1), "list 'extra' of -1 entries"),
    "longest_list.ply": (with_list("<I", 2**32 - 1, "uint"), "announces 20.*holds 0.*truncated"),
    "cut_inside_count.ply": (
        ply_bytes(V, F).replace(b"list uchar", b"list int")[: -len(F) * 13] + b"\x03\0",
        "truncated",
    ),
    "header_in_comment.ply": ("ply\nformat ascii 1.0\ncomment end_header\n", "header does not end"),
    "bytes_left_over.stl": (stl_bytes(V, F) + bytes(60), "60 bytes are left over"),
    "stray_corner.stl": (STL.replace("endfacet", "", 1), "facet with 3 corners instead"),
    "packed_4000_times.npz": (BOMB.getvalue(), "more than 100 times as many"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_wrong_is_said_in_one_line(tmp_path, name):
    content, words = REFUSED[name]
    with pytest.raises(SurfaceError) as caught:
        read_surface(put(tmp_path, name, content))
    message = str(caught.value)
    assert name in message and "\n" not in message and len(message) < 600
    assert re.search(words, message), message


SINGLE = ply_bytes(V, F).replace(b"double", b"float")
SINGLE = SINGLE.replace(V.astype("<f8").tobytes(), V.astype("<f4").tobytes())
TRAPS = {
    "a.stl": with_signalling_nan(stl_bytes(V, F), 84 + 12),
    "a.ply": with_signalling_nan(SINGLE, SINGLE.index(b"end_header\n") + 11),
}


@pytest.mark.parametrize("name", TRAPS)
def test_numbers_that_are_none_are_named_by_the_check(tmp_path, name):
    with pytest.raises(SurfaceError, match="non_finite_coordinates"):
        read_surface(put(tmp_path, name, TRAPS[name]))


@pytest.mark.parametrize("path", sorted((DATA / "damaged").iterdir()), ids=lambda path: path.stem)
def test_damaged_files_are_refused_in_one_line(path):
    with pytest.raises(SurfaceError, match=path.name) as caught:
        read_surface(path)
    assert "\n" not in str(caught.value)


def test_packed_zeros_are_refused_before_they_are_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(SurfaceError, match="unpacks"):
        read_surface(put(tmp_path, "a.npz", BOMB.getvalue()))


def test_no_more_is_unpacked_than_is_announced(tmp_path):
    data = bytearray(BOMB.getvalue())
    at = data.rindex(b"PK\x01\x02") + 24
    data[at : at + 4] = data[22:26] = struct.pack("<I", 1000)
    path = put(tmp_path, "a.npz", bytes(data))
    tracemalloc.start()
    with pytest.raises(SurfaceError, match="damaged"):
        read_surface(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * len(data)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_that_cannot_be_stopped_are_not_unpacked(tmp_path, method):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", method) as archive:
        for name, array in (("vertices", V), ("faces", F)):
            with archive.open(name + ".npy", "w") as out:
                np.lib.format.write_array(out, array)
    with pytest.raises(SurfaceError, match="unusual way"):
        read_surface(tmp_path / "a.npz")


def test_a_link_that_leads_nowhere_is_called_one(tmp_path):
    loop, dangling = tmp_path / "loop.ply", tmp_path / "dangling.ply"
    os.symlink(loop, loop)
    os.symlink(tmp_path / "gone.ply", dangling)
    for path in (loop, dangling):
        with pytest.raises(FileNotFoundError, match="is a symbolic link that leads nowhere"):
            read_surface(path)

"""Inputs that no program writes: good files damaged, and files whose headers announce anything.

Every function takes a `random.Random`, so that hypothesis can drive it and a seed repeats it.
"""

import base64
import io
import struct
import zipfile
import zlib
from random import Random

import numpy as np

from jaxwillmore.cases import example_names, example_path
from jaxwillmore.mesh import icosphere

from .surfaces import ball, obj_text, off_text, ply_bytes, ply_text, stl_bytes, stl_text

V, F = ball(0)
COUNTS = ("0", "1", "3", "12", "20", "-1", "-0", "1e3", "nan", "inf", "4294967295", "2147483648")
COUNTS += (
    "18446744073709551616",
    "9" * 18,
    "9" * 5000,
    "0x10",
    "1_0",
    "٣",
    "",
    "\0",
    "(((",
    "12.5",
)
NUMBERS = (
    "0.5",
    "-1",
    "nan",
    "inf",
    "-1e999",
    "1e308",
    "1_0",
    "1,5",
    "#",
    "\0",
    "-1.#IND",
    "4e-324",
)
VALUES = (
    "1",
    "-1",
    "0",
    "0.5",
    "nan",
    "-inf",
    "1e400",
    "9" * 5000,
    "true",
    '"sphere"',
    '"a\\u0000"',
)
VALUES += ("[]", "[[1, 2], 3]", "{}", "{a = {b = 1}}", "1979-05-27", "'''\n'''", "[1.0, 1.0, 2.0]")
VALUES += (
    '"../../a.ply"',
    '""',
    "[" * 300 + "]" * 300,
    "0x" + "f" * 2000,
    "1_000",
    "07:32:00",
    "[",
)


def good_files() -> dict[str, list[bytes]]:
    """Whole files of every kind, by what their names end in."""
    mesh, x = icosphere(0, degree=2)
    arrays, own = io.BytesIO(), io.BytesIO()
    np.savez(arrays, vertices=V, faces=F)
    np.savez(own, x=np.array(x), cells=np.array(mesh.cells), degree=np.array(2))
    return {
        "ply": [ply_text(V, F).encode(), ply_bytes(V, F), ply_bytes(V, F, ">")],
        "off": [off_text(V, F).encode(), " ".join(off_text(V, F).split()).encode()],
        "obj": [obj_text(V, F).encode()],
        "stl": [stl_bytes(V, F), stl_text(V, F).encode()],
        "npz": [arrays.getvalue(), own.getvalue()],
        "vtu": [vtu(Random(0), hostile=False)],
        "toml": [example_path(f"example:{name}").read_bytes() for name in example_names()],
    }


def damaged(random: Random, data: bytes) -> bytes:
    """A file with one to three places changed, cut, doubled, filled, or said otherwise."""
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        at = random.randrange(len(data) + 1) if random.random() < 0.5 else random.randrange(400)
        size = random.choice((1, 1, 1, 2, 4, 8, 50, 500))
        here, rest = data[:at], data[at + size :]
        match random.randrange(7):
            case 0:
                data = here
            case 1:
                data = here + bytes(random.randrange(256) for _ in range(size)) + rest
            case 2:
                data = here + rest
            case 3:
                data = here + data[at : at + size] + data[at:]
            case 4:
                data = here + bytes([random.choice((0, 10, 32, 127, 255))]) * size + rest
            case 5:
                data = here + random.choice(COUNTS + NUMBERS).encode() + rest
            case 6:
                data = _other_word(random, data)
    return data


def _other_word(random: Random, data: bytes) -> bytes:
    """One word of the first lines replaced."""
    words = data[:600].split()
    if not words:
        return data
    return data.replace(random.choice(words), random.choice(COUNTS + NUMBERS + VALUES).encode(), 1)


def generated(random: Random, kind: str) -> bytes:
    """A file with a header of its kind that announces anything, and some body."""
    return {
        "ply": ply, "off": off, "obj": obj, "stl": stl, "npz": npz, "vtu": vtu, "toml": toml,
    }[kind](random)  # fmt: skip


def _often(random: Random, usual, others):
    """What a good file has, three times out of four."""
    return usual if random.random() < 0.75 else random.choice(others)


def _words(random: Random, n: int, *kinds) -> str:
    return " ".join(random.choice(random.choice(kinds)) for _ in range(n))


def _body(random: Random) -> bytes:
    n = random.choice((0, 1, 7, 100, 1000))
    good = V.tobytes() + b"".join(b"\x03" + row.astype("<i4").tobytes() for row in F)
    others = (bytes(n), b"\xff" * n, bytes(random.randrange(256) for _ in range(n)), good[:-n])
    return _often(random, good, others)


def ply(random: Random) -> bytes:
    types = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double", "int8", "list")
    newline = _often(random, "\n", ("\r\n", "\r"))
    order = _often(random, "binary_little_endian", ("ascii", "binary_big_endian", "binary"))
    lines = ["ply", f"format {order} {_often(random, '1.0', ('2.0', ''))}"]
    for name in _often(random, ("vertex", "face"), (("face", "vertex"), ("a", "vertex", "face"))):
        length = "12" if name == "vertex" else "20"
        lines.append(f"element {name} {_often(random, length, COUNTS)}")
        names = ["x", "y", "z"] if name == "vertex" else ["vertex_indices"]
        for extra in range(_often(random, 0, (1, 2))):
            names.insert(random.randrange(len(names) + 1), f"p{extra}")
        for prop in names:
            is_list = prop == "vertex_indices" or random.random() < 0.1
            size = f"list {_often(random, 'uchar', types)} " if is_list else ""
            usual = "double" if name == "vertex" else "int"
            lines.append(f"property {size}{_often(random, usual, types)} {prop}")
    lines += _often(random, ["end_header"], (["comment end_header"], []))
    head = newline.join([*lines, ""]).encode()
    text = _words(random, random.choice((0, 5, 200)), COUNTS, NUMBERS, ("\n",)).encode()
    return head + (text if order == "ascii" else _body(random))


def off(random: Random) -> bytes:
    word = random.choice(("OFF", "COFF", "STNOFF", "OFF12", "OFF BINARY", "4OFF"))
    counts = " ".join(_often(random, usual, COUNTS) for usual in ("12", "20", "0"))
    gap = random.choice((" ", "\n"))
    kinds = (COUNTS, NUMBERS, ("\n", "3", "0"))
    body = _words(random, random.choice((0, 9, 120)), *kinds)
    body = _often(random, off_text(V, F).split("\n", 2)[2], (body,))
    return f"{_often(random, 'OFF', (word,))}{gap}{counts}{gap}{body}".encode()


def obj(random: Random) -> bytes:
    lines = []
    for _ in range(random.randrange(60)):
        kind = random.choice(("v", "v", "f", "f", "vn", "g", "#", "f\\", "l"))
        count = random.choice((0, 2, 3, 3, 3, 4))
        slash = random.choice(("", "", "/1", "//", "/" * 50))
        words = (random.choice(COUNTS[:12] + NUMBERS) + slash for _ in range(count))
        lines.append(" ".join([kind, *words]))
    return "\n".join(lines).encode()


def stl(random: Random) -> bytes:
    if random.random() < 0.5:
        count = _often(random, 20, (0, 1, 2, 19, 2**31, 2**32 - 1))
        head = random.choice((b"", b"solid facet", b"\xef\xbb\xbf", b"\xff\xfe")).ljust(80)
        body = _often(random, stl_bytes(V, F)[84:], (_body(random), b"\0" * 49))
        return head + struct.pack("<I", count) + body
    words = ("solid", "facet", "endfacet", "vertex", "vertex 0 0 1", "loop", "endsolid", "\n", "\n")
    return ("solid " + _words(random, random.choice((3, 30, 200)), words, words, NUMBERS)).encode()


def npz(random: Random) -> bytes:
    out = io.BytesIO()
    shapes = (
        "(12, 3)",
        "(20, 3)",
        "()",
        "(0, 0)",
        "(-1,)",
        "(((",
        f"({'9' * 5000},)",
        "(2, 9999999999)",
    )
    descrs = (
        "<f8",
        "<i8",
        ">f4",
        "|O",
        "<U9999999",
        "V0",
        "[('a', '<f8')]",
        "<f3",
        "",
        "\0",
        "<M8[s]",
    )
    hostile = ("{" * 200, "(" * 9000, "-" * 5000, "{'descr': " * 50, "None", "", "\xff")
    with zipfile.ZipFile(out, "w", _often(random, 8, (0, 12, 14))) as archive:
        names = ["x", "cells"] if random.random() < 0.5 else ["vertices", "faces"]
        for name in names + _often(random, [], (["extra"],)):
            is_x = name in ("x", "vertices")
            descr = _often(random, "<f8" if is_x else "<i8", descrs)
            order = _often(random, "False", ("True", "1"))
            shape = _often(random, "(12, 3)" if is_x else "(20, 3)", shapes)
            text = f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n"
            head = _often(random, text, hostile).encode("latin-1")
            length = _often(random, len(head), (0, 65535, len(head) // 2))
            magic = b"\x93NUMPY" + bytes([_often(random, 1, (2, 3, 200)), 0])
            form = "<H" if magic[6] == 1 else "<I"
            data = V.tobytes() if is_x else F.tobytes()
            data = _often(random, data, (_body(random), bytes(2**20)))
            archive.writestr(f"{name}.npy", magic + struct.pack(form, length) + head + data)
    return out.getvalue()


def _encoded(random: Random, array: np.ndarray, hostile: bool) -> str:
    packed = zlib.compress(array.tobytes())
    counts = [1, array.nbytes, 0, len(packed)]
    if hostile and random.random() < 0.3:
        counts[random.randrange(4)] = random.choice((0, 1, 2**20, 2**63, 2**64 - 1))
    header = base64.b64encode(np.array(counts, "<u8").tobytes())
    return (header + base64.b64encode(packed)).decode()


def vtu(random: Random, hostile: bool = True) -> bytes:
    arrays = {
        "Points": ("Float64", V.astype("<f8")),
        "connectivity": ("Int64", F.astype("<i8")),
        "offsets": ("Int64", 3 * np.arange(1, len(F) + 1)),
        "types": ("UInt8", np.full(len(F), 5, np.uint8)),
    }
    parts = {}
    for name, (kind, array) in arrays.items():
        text, form = _encoded(random, array, hostile), "binary"
        if hostile and random.random() < 0.2:
            kind = random.choice(("Float32", "Int32", "UInt8", "Float64", "Int64", "String"))
        if hostile and random.random() < 0.2:
            text, form = _words(random, 40, COUNTS[:12], NUMBERS[:6]), "ascii"
        if hostile and random.random() < 0.1:
            form = random.choice(("appended", "ascii", "", "binary"))
        parts[name] = f'<DataArray type="{kind}" Name="{name}" format="{form}">{text}</DataArray>'
    points = parts.pop("Points")
    return (
        '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" byte_order="LittleEndian" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor"><UnstructuredGrid><Piece>'
        f"<Points>{points}</Points><Cells>{''.join(parts.values())}</Cells>"
        "</Piece></UnstructuredGrid></VTKFile>"
    ).encode()


SECTIONS = ("surface", "energy", "energy.osmotic", "phase", "constraints", "flow", "time", "branch")
SECTIONS += ("output", "target", "model", "fit", "surface.a", "surfaces", '"a.b"')
KEYS = ("shape", "file", "level", "degree", "repair", "keep", "components", "genus", "radius", "t1")
KEYS += (
    "bending_modulus",
    "kind",
    "mean",
    "area",
    "volume",
    "reduced_volume",
    "every",
    "stop",
    "free",
)
KEYS += ("semi_axes", "times", "method", "hold", "start", "a", '"\\u0000"')


def toml(random: Random) -> bytes:
    lines = []
    for _ in range(random.randrange(1, 5)):
        lines.append(f"[{random.choice(SECTIONS)}]")
        for _ in range(random.randrange(4)):
            lines.append(f"{random.choice(KEYS)} = {random.choice(VALUES)}")
    encoding = random.choice(("utf-8", "utf-8", "utf-8", "utf-16", "utf-8-sig"))
    return random.choice(("\n", "\r\n")).join([*lines, ""]).encode(encoding)

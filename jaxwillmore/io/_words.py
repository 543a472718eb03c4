"""Words of a text file as numbers, with the line in every complaint."""

import numpy as np

from ..mesh import SurfaceError

TRIANGULATE = (
    "Only triangles are read; convert the file, for example with "
    "`pyvista.read(file).triangulate().save('triangles.ply')` or MeshLab's "
    "'Turn into a Pure-Triangular mesh'"
)


_MARKS = {
    b"\xff\xfe\0\0": "UTF-32",
    b"\0\0\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}
_MOST_DIGITS = 18


def without_mark(data: bytes) -> bytes:
    """The file without the byte order mark that some programs write before UTF-8."""
    return data.removeprefix(b"\xef\xbb\xbf")


def wide_encoding(data: bytes) -> str | None:
    """The name of an encoding that takes two or four bytes per letter, where the file is in one."""
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            return encoding
    head = data[:64]
    pairs = len(head) // 2
    if pairs > 1 and b"\0\0" not in head and pairs in (head[::2].count(0), head[1::2].count(0)):
        return "UTF-16"
    return None


def text_of(name: str, data: bytes, format: str) -> str:
    """The file as text; odd bytes may stand in comments, so they are no reason to refuse."""
    encoding = wide_encoding(data)
    if encoding is not None:
        raise SurfaceError(
            f"{name}: it is text in {encoding}; save it as UTF-8, for example with "
            f"`iconv -f {encoding} -t UTF-8`."
        )
    if b"\0" in data:
        raise SurfaceError(f"{name}: not an {format} file in text form: it holds binary data.")
    return without_mark(data).decode("utf-8", errors="replace")


def coordinates(name: str, line: int, words: list[str]) -> list[float]:
    """The first three words as floats; NaN passes and is found by the check of the surface."""
    if len(words) < 3:
        raise SurfaceError(
            f"{name}, line {line}: a vertex needs three coordinates, found {len(words)}; the file "
            "may be truncated."
        )
    try:
        return [_plain(float, word) for word in words[:3]]
    except ValueError as error:
        hint = " (write decimal points, not commas)" if any("," in w for w in words[:3]) else ""
        text = " ".join(words[:3])[:80]
        raise SurfaceError(f"{name}, line {line}: {text!r} is not a point{hint}.") from error


def face(name: str, line: int, words: list[str]) -> list[int]:
    """Three words as whole numbers."""
    if len(words) < 3:
        raise SurfaceError(
            f"{name}, line {line}: a face with {len(words)} corners; the file may be truncated."
        )
    if len(words) > 3:
        raise SurfaceError(f"{name}, line {line}: a face with {len(words)} corners. {TRIANGULATE}.")
    try:
        return [_plain(int, word) for word in words]
    except ValueError as error:
        text = " ".join(words)[:80]
        raise SurfaceError(
            f"{name}, line {line}: {text!r} are not three vertex numbers."
        ) from error


def _plain(kind: type, word: str):
    """A number as files have it: Python alone reads `1_0` as 10, and digits of any script."""
    if "_" in word or not word.isascii():
        raise ValueError
    return kind(word)


def count(name: str, line: int, word: str, what: str) -> int:
    """A number of vertices or faces from a header."""
    if not (word.isascii() and word.isdigit()) or len(word) > _MOST_DIGITS:
        shown = word if len(word) <= 40 else f"{word[:20]}... ({len(word)} characters)"
        raise SurfaceError(f"{name}, line {line}: {shown!r} is not a number of {what:.40}.")
    return int(word)


def short_of(name: str, what: str, announced: int, found: int) -> SurfaceError:
    """The complaint about a file that ends too early."""
    return SurfaceError(
        f"{name}: the header announces {announced} {what}, the file holds {found}; it is "
        "truncated or damaged. Fetch or export it again."
    )


def mesh_arrays(
    name: str, vertices: list[list[float]], faces: list[list[int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Lists of a text file as arrays; vertex numbers too long for a computer are refused."""
    for number, corners in enumerate(faces):
        if max(map(abs, corners)) >= 2**31:
            shown = str(max(corners, key=abs))[:40]
            raise SurfaceError(f"{name}: face {number} names vertex {shown}, which cannot be.")
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        np.array(faces, dtype=np.int64).reshape(-1, 3),
    )

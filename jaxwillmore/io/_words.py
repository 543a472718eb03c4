"""Words of a text file as numbers, with the line in every complaint."""

import numpy as np

from ..mesh import SurfaceError

TRIANGULATE = (
    "Only triangles are read; convert the file, for example with "
    "`pyvista.read(file).triangulate().save('triangles.ply')` or MeshLab's "
    "'Turn into a Pure-Triangular mesh'"
)


def text_of(name: str, data: bytes, format: str) -> str:
    """The file as text; odd bytes may stand in comments, so they are no reason to refuse."""
    if b"\0" in data:
        raise SurfaceError(f"{name}: not an {format} file: it holds binary data.")
    return data.decode("utf-8", errors="replace")


def coordinates(name: str, line: int, words: list[str]) -> list[float]:
    """The first three words as floats; NaN passes and is found by the check of the surface."""
    if len(words) < 3:
        raise SurfaceError(
            f"{name}, line {line}: a vertex needs three coordinates, found {len(words)}; the file "
            "may be truncated."
        )
    try:
        return [float(word) for word in words[:3]]
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
        return [int(word) for word in words]
    except ValueError as error:
        text = " ".join(words)[:80]
        raise SurfaceError(
            f"{name}, line {line}: {text!r} are not three vertex numbers."
        ) from error


def count(name: str, line: int, word: str, what: str) -> int:
    """A number of vertices or faces from a header."""
    if not (word.isascii() and word.isdigit()):
        raise SurfaceError(f"{name}, line {line}: {word[:80]!r} is not a number of {what}.")
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
            raise SurfaceError(f"{name}: face {number} names vertex {max(corners, key=abs)}.")
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        np.array(faces, dtype=np.int64).reshape(-1, 3),
    )

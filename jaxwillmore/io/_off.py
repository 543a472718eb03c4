"""OFF files. Read here and not by trimesh, which cuts polygons into triangles without a word.

The format is free: numbers follow each other, lines mean nothing. Only colours, whose number the
format leaves open, need lines to end them.
"""

import re
from typing import NamedTuple

import numpy as np

from ..mesh import SurfaceError
from ._words import coordinates, count, face, mesh_arrays, short_of, text_of

# What follows each position: texture coordinates, a colour, a normal, none of which is read. Some
# programs write the first count right behind the word.
_KEYWORD = re.compile(r"(ST)?(C)?(N)?OFF(?=\d*$)")
_SIZES = (2, 4, 3)

Words = list[tuple[int, list[str]]]


class _Header(NamedTuple):
    n_vertices: int
    n_faces: int
    width: int
    """Numbers per vertex."""
    rest: Words
    """Lines behind the counts, with their numbers."""


def begins_off(word: str) -> bool:
    """Whether a file that begins with this word is OFF."""
    return _KEYWORD.match(word) is not None


def parse_off(name: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an OFF file, vertex numbers not yet checked against the vertices."""
    header = _header(name, text_of(name, data, "OFF"))
    n_vertices, n_faces, lines = header.n_vertices, header.n_faces, header.rest
    if len(lines) != n_vertices + n_faces:
        free = _rows(header)
        if free is None:
            raise _complaint(name, header)
        lines = free
    vertices = [coordinates(name, n, words) for n, words in lines[:n_vertices]]
    faces = []
    for n, (corners, *words) in lines[n_vertices:]:
        wanted = count(name, n, corners, "corners")
        if len(words) < wanted:
            raise short_of(f"{name}, line {n}", "corners", wanted, len(words))
        faces.append(face(name, n, words[:wanted]))
    return mesh_arrays(name, vertices, faces)


def _header(name: str, text: str) -> _Header:
    split = ((n, line.split("#")[0].split()) for n, line in enumerate(text.splitlines(), start=1))
    lines = [(n, words) for n, words in split if words]
    match = _KEYWORD.match(lines[0][1][0]) if lines else None
    if match is None:
        raise SurfaceError(f"{name}: not an OFF file: it does not begin with the word OFF.")
    if "BINARY" in lines[0][1][1:2]:
        raise SurfaceError(f"{name}: binary OFF is not read; export text, or PLY.")
    n, (first, *words) = lines.pop(0)
    words = [first[match.end() :], *words] if first[match.end() :] else words
    if words:
        lines.insert(0, (n, words))
    counts: list[tuple[int, str]] = []
    while lines and len(counts) < 3:
        n, words = lines.pop(0)
        room = 3 - len(counts)
        counts += [(n, word) for word in words[:room]]
        if words[room:]:
            lines.insert(0, (n, words[room:]))
        if len(words) == 2:
            break  # many programs leave out the number of edges
    if len(counts) < 2:
        raise SurfaceError(
            f"{name}: the numbers of vertices and faces after OFF are missing; the file is "
            "truncated."
        )
    n_vertices = count(name, *counts[0], "vertices")
    n_faces = count(name, *counts[1], "faces")
    width = 3 + sum(size for size, used in zip(_SIZES, match.groups(), strict=True) if used)
    return _Header(n_vertices, n_faces, width, lines)


def _rows(header: _Header) -> Words | None:
    """One row per vertex and face out of words in any lines, if they are exactly enough."""
    words = [(n, word) for n, line in header.rest for word in line]
    at, rows = header.n_vertices * header.width, []
    if len(words) < at + 4 * header.n_faces:
        return None
    for start in range(0, at, header.width):
        rows.append((words[start][0], [word for _, word in words[start : start + header.width]]))
    for _ in range(header.n_faces):
        size = words[at][1] if at < len(words) else ""
        if not (size.isascii() and size.isdigit()) or len(size) > 9:
            return None
        end = at + 1 + int(size)
        if end > len(words):
            return None
        rows.append((words[at][0], [word for _, word in words[at:end]]))
        at = end
    return rows if at == len(words) else None


def _complaint(name: str, header: _Header) -> SurfaceError:
    """What is wrong with a file that holds too little or too much, seen by lines."""
    n_vertices, n_faces, lines = header.n_vertices, header.n_faces, header.rest
    n_words = sum(len(words) for _, words in lines)
    n_needed = n_vertices * header.width + 4 * n_faces
    if n_words < n_needed:
        # as many rows as lines, or, where lines are far too long for one row each, as words fill
        in_lines = n_words <= 4 * header.width * len(lines)
        vertices = len(lines) if in_lines else n_words // header.width
        if vertices < n_vertices:
            return short_of(name, "vertices", n_vertices, vertices)
        faces = len(lines) - n_vertices if in_lines else (n_words - n_vertices * header.width) // 4
        return short_of(name, "faces", n_faces, max(0, min(faces, n_faces - 1)))
    if len(lines) < n_vertices + n_faces:
        return SurfaceError(
            f"{name}: {n_vertices} vertices and {n_faces} faces are announced, and {n_words} "
            f"numbers follow in {len(lines)} lines; triangles alone take {n_needed}. Write every "
            "vertex and every face into a line of its own."
        )
    return SurfaceError(
        f"{name}, line {lines[n_vertices + n_faces][0]}: the file goes on after the "
        f"{n_vertices} vertices and {n_faces} faces it announces."
    )

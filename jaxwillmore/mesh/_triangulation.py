"""A closed triangulation that changes: edges are split, collapsed and flipped, one at a time."""

from collections import defaultdict

import numpy as np
from jaxtyping import Float, Int

from ._adjacency import Triangles

# Normals of the triangles around an edge may turn by so much in one change: cos 45°.
MOST_TURN = 0.7
REGULAR = 6


class Triangulation:
    """Triangles by number, and around every vertex the numbers of its triangles.

    Every change keeps the surface closed, oriented and of the same genus, and is refused where it
    would turn a triangle by more than 45° or leave a vertex with fewer than three neighbours.
    """

    def __init__(self, triangles: Triangles, x: Float[np.ndarray, "vertices 3"]):
        self.x = [tuple(map(float, point)) for point in x]
        self.faces: dict[int, tuple[int, int, int]] = {}
        self.around: dict[int, set[int]] = defaultdict(set)
        self._next = 0
        for triangle in triangles:
            self._add(*map(int, triangle))

    def arrays(self) -> tuple[Int[np.ndarray, "cells 3"], Float[np.ndarray, "vertices 3"]]:
        """Triangles and vertices, with numbers without gaps."""
        used = sorted(v for v, faces in self.around.items() if faces)
        number = {v: k for k, v in enumerate(used)}
        cells = [[number[v] for v in face] for face in self.faces.values()]
        return np.array(cells), np.array([self.x[v] for v in used])

    def edges(self) -> list[tuple[int, int]]:
        """All edges, each once, as pairs of rising numbers."""
        return [
            (a, b)
            for face in self.faces.values()
            for a, b in zip(face, (*face[1:], face[0]), strict=True)
            if a < b
        ]

    def length(self, a: int, b: int) -> float:
        """Distance of two vertices."""
        return sum((p - q) ** 2 for p, q in zip(self.x[a], self.x[b], strict=True)) ** 0.5

    def valence(self, v: int) -> int:
        """Number of neighbours."""
        return len(self.around[v])

    def neighbours(self, v: int) -> set[int]:
        """The vertices that have an edge to this one."""
        return {u for f in self.around[v] for u in self.faces[f]} - {v}

    def are_joined(self, a: int, b: int) -> bool:
        """Whether there is still an edge between two vertices."""
        return len(self._beside(a, b)) == 2

    def split(self, a: int, b: int) -> int:
        """Put a vertex in the middle of an edge, which becomes four triangles; its number."""
        middle = len(self.x)
        self.x.append(tuple(0.5 * (p + q) for p, q in zip(self.x[a], self.x[b], strict=True)))
        for f in self._beside(a, b):
            face = self.faces[f]
            self._drop(f)
            self._add(*(middle if v == a else v for v in face))
            self._add(*(middle if v == b else v for v in face))
        return middle

    def collapse(self, a: int, b: int, longest: float) -> bool:
        """Make one vertex of the two ends of an edge, in its middle, where that is sound.

        It is not where another edge would be longer than `longest`.
        """
        beside = self._beside(a, b)
        common = self.neighbours(a) & self.neighbours(b)
        if len(beside) != 2 or len(common) != 2 or min(map(self.valence, common)) <= 3:
            return False
        if self.valence(a) + self.valence(b) - 4 < 3:
            return False
        old = self.x[a], self.x[b]
        middle = tuple(0.5 * (p + q) for p, q in zip(*old, strict=True))
        changed = (self.around[a] | self.around[b]) - set(beside)
        before = {f: self._normal(f) for f in changed}
        self.x[a] = self.x[b] = middle
        ring = (self.neighbours(a) | self.neighbours(b)) - {a, b}
        sound = max(self.length(a, v) for v in ring) <= longest
        if not (sound and all(_near(before[f], self._normal(f)) for f in changed)):
            self.x[a], self.x[b] = old
            return False
        for f in beside:
            self._drop(f)
        for f in list(self.around[b]):
            face = self.faces[f]
            self._drop(f)
            self._add(*(a if v == b else v for v in face))
        del self.around[b]
        return True

    def flip(self, a: int, b: int) -> bool:
        """Turn an edge in its two triangles where that brings four vertices nearer to valence 6."""
        beside = self._beside(a, b)
        if len(beside) != 2:
            return False
        c, d = (next(v for v in self.faces[f] if v not in (a, b)) for f in beside)
        if c == d or d in self.neighbours(c) or min(self.valence(a), self.valence(b)) <= 3:
            return False
        now = [self.valence(v) - REGULAR for v in (a, b, c, d)]
        then = [now[0] - 1, now[1] - 1, now[2] + 1, now[3] + 1]
        if sum(n * n for n in then) >= sum(n * n for n in now):
            return False
        first, second = self.faces[beside[0]], self.faces[beside[1]]
        one = tuple(d if v == b else v for v in first)
        two = tuple(c if v == a else v for v in second)
        normals = [_unit(*(self.x[v] for v in face)) for face in (first, second, one, two)]
        if not all(_near(n, m) for n in normals[:2] for m in normals[2:]):
            return False
        for f in beside:
            self._drop(f)
        self._add(*one)
        self._add(*two)
        return True

    def _add(self, a: int, b: int, c: int) -> None:
        self.faces[self._next] = (a, b, c)
        for v in (a, b, c):
            self.around[v].add(self._next)
        self._next += 1

    def _drop(self, f: int) -> None:
        for v in self.faces.pop(f):
            self.around[v].discard(f)

    def _beside(self, a: int, b: int) -> list[int]:
        """The triangles at an edge."""
        return sorted(self.around.get(a, set()) & self.around.get(b, set()))

    def _normal(self, f: int):
        return _unit(*(self.x[v] for v in self.faces[f]))


def _unit(p, q, r) -> tuple[float, float, float]:
    ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    bx, by, bz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    n = (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    size = (n[0] ** 2 + n[1] ** 2 + n[2] ** 2) ** 0.5 or 1.0
    return n[0] / size, n[1] / size, n[2] / size


def _near(n, m) -> bool:
    return n[0] * m[0] + n[1] * m[1] + n[2] * m[2] > MOST_TURN

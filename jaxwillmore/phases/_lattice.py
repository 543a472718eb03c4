"""A reference triangle cut into small ones."""

import functools as ft
import itertools

import numpy as np
from jaxtyping import Float, Int

from ..reference import lagrange_nodes


@ft.cache
def lattice(n: int) -> tuple[Float[np.ndarray, "points 2"], Int[np.ndarray, "small 3"]]:
    """The points (i, j)/n of the reference triangle, and its n² small triangles."""
    points = [(i, j) for j in range(n + 1) for i in range(n + 1 - j)]
    number = {point: k for k, point in enumerate(points)}
    up = [((i, j), (i + 1, j), (i, j + 1)) for i, j in points if i + j < n]
    down = [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in points if i + j < n - 1]
    return np.array(points) / n, np.array([[number[p] for p in small] for small in up + down])


@ft.cache
def neighbours(degree: int) -> Int[np.ndarray, "pairs 2"]:
    """Pairs of nodes of a cell, in the local order, that are corners of one small triangle."""
    # Rounded, because thirds are not exact.
    m = np.rint(lagrange_nodes(degree) * degree).astype(int)
    m = np.concatenate([degree - m.sum(axis=1, keepdims=True), m], axis=1)
    pairs = itertools.combinations(range(len(m)), 2)
    return np.array([(i, j) for i, j in pairs if np.abs(m[i] - m[j]).sum() == 2])

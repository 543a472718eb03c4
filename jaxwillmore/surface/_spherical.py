r"""A smooth surface through measured points, by spherical harmonics on a conformal sphere."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ..mesh import SurfaceError, SurfaceMesh, check_surface, icosphere
from ._conformal import conformal_sphere, vertex_areas
from ._harmonics import real_harmonics
from ._measures import area, volume

MOST_DEGREE = 16
# Vertices for every harmonic: with fewer the noise decides the shape.
VERTICES_EACH = 4
# Left out together: a vertex and its neighbours, whose errors are alike, in so many parts.
IN_A_BLOCK, PARTS = 7, 8
# Of all vertex areas: what holds the harmonics that no vertex tells.
RIDGE = 1e-9


class _Surface(NamedTuple):
    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]


class SphericalSurface(_Surface):
    r"""The pair `(mesh, x)` of a surface by harmonics, and how it was found.

    **Attributes:**

    - `harmonic_degree`: the largest l of the harmonics.
    - `coefficients`: $c_{lm}$ of $x(n) = \sum c_{lm} Y_{lm}(n)$, in the order of `real_harmonics`.
    - `rms`, `largest`: distance of the vertices from their places on the surface, length.
    - `errors`: by degree, the rms distance of vertices that were left out, length.
    - `area_change`, `volume_change`: of the surface, over those of the triangles, less one.
    """

    harmonic_degree: int
    coefficients: Float[np.ndarray, "harmonics 3"]
    rms: float
    largest: float
    errors: dict[int, float]
    area_change: float
    volume_change: float

    def in_words(self) -> str:
        """One sentence for a log."""
        return (
            f"by spherical harmonics of degree {self.harmonic_degree}: rms distance of the "
            f"vertices {self.rms:.3g}, largest {self.largest:.3g}; area {self.area_change:+.2%}, "
            f"volume {self.volume_change:+.2%} of the triangles'"
        )


def spherical(
    vertices: Float[Array | np.ndarray, "vertices 3"],
    faces: Int[Array | np.ndarray, "faces 3"],
    *,
    max_degree: int | None = None,
    level: int = 2,
    degree: int = 2,
) -> SphericalSurface:
    r"""A smooth surface on a clean mesh for a measured one of genus 0.

    For segmented cells: a staircase of voxels, a noisy scan, irregular triangles. A conformal map
    takes the vertices to directions n on a sphere, whether the cell is star-shaped or not;
    $x(n) = \sum_{l \le L} c_{lm} Y_{lm}(n)$ is fitted by least squares with the areas of the
    vertices, and an icosphere is mapped by it.

    L is chosen by cross-validation: blocks of neighbouring vertices are left out and predicted by
    the others, and the smallest L is taken that is within one standard error of the best. So a
    label image of a ball gives a ball, and a clean mesh keeps its details.

    **Arguments:**

    - `vertices`, `faces`: a closed triangle mesh without handles, normals out, any unit.
    - `max_degree`: the largest L that is tried; by default 16, or less for fewer than 4 vertices
      for each harmonic.
    - `level`, `degree`: of the icosphere (`mesh.icosphere`).

    **Returns:** a `SphericalSurface`, which is the pair `(mesh, x)`, x in the unit of the vertices.

    *Limits:* errors that more than about seven neighbours share are taken for shape.

    **Raises:** `mesh.SurfaceError` for a mesh that is not closed, or not one piece without handles;
    `ValueError` for degrees that the vertices do not determine, and where the conformal map or the
    surface by harmonics folds.

    ??? cite "Reference"
        Brechbühler, Gerig, Kübler (1995), *Comput. Vis. Image Underst.* 61, 154–170 (SPHARM); the
        rule of one standard error: Hastie, Tibshirani, Friedman (2009), *The Elements of
        Statistical Learning*, section 7.10.

    ```python
    mesh, x = jw.surface.spherical(vertices, faces)
    ```
    """
    V, F = _checked(vertices, faces)
    most = _limit(len(V), max_degree)
    areas = vertex_areas(V, F)
    n = conformal_sphere(V, F)
    mesh, directions = icosphere(level, degree)
    both = _harmonics(most, jnp.concatenate([jnp.asarray(n), directions]))
    Y = np.asarray(both[: len(V)])
    L, errors = _chosen(Y, V, areas, n, most)
    c = _solved(*_normal_equations(Y, V, areas), L, areas.sum())
    distance = np.linalg.norm(Y[:, : (L + 1) ** 2] @ c - V, axis=1)
    x = both[len(V) :, : (L + 1) ** 2] @ jnp.asarray(c)
    A, volume_ = _area_and_volume(V, F)
    new_A, new_volume = _checked_image(mesh, x, L)
    found = SphericalSurface(mesh, x)
    found.harmonic_degree, found.coefficients, found.errors = L, c, errors
    found.rms = float(np.sqrt(areas @ distance**2 / areas.sum()))
    found.largest = float(distance.max())
    found.area_change, found.volume_change = new_A / A - 1, new_volume / volume_ - 1
    return found


@eqx.filter_jit
def _harmonics(most: int, n: Float[Array, "points 3"]) -> Float[Array, "points harmonics"]:
    return jax.vmap(lambda direction: real_harmonics(most, direction))(n)


def _checked(vertices, faces):
    V, F = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    report = check_surface(V, F, genus=0)
    if not report.ok:
        raise SurfaceError(f"Harmonics need a closed surface of genus 0. {report}", report)
    return V, F


def _limit(n_vertices: int, max_degree: int | None) -> int:
    """The largest degree to try."""
    told = int(np.sqrt(n_vertices / VERTICES_EACH)) - 1
    if told < 1:
        raise ValueError(f"{n_vertices} vertices determine no harmonics; 16 are the least.")
    if max_degree is None:
        return min(MOST_DEGREE, told)
    if not 1 <= max_degree <= told:
        raise ValueError(
            f"`max_degree` must be from 1 to {told}, for {VERTICES_EACH} vertices to every one of "
            f"its (L + 1)² harmonics; got {max_degree} with {n_vertices} vertices."
        )
    return max_degree


def _normal_equations(Y, V, areas):
    weighted = areas[:, None] * Y
    return weighted.T @ Y, weighted.T @ V


def _solved(G, b, L: int, total: float) -> Float[np.ndarray, "harmonics 3"]:
    """Least squares with the harmonics up to degree L, which come first in G and b."""
    m = (L + 1) ** 2
    return np.linalg.solve(G[:m, :m] + RIDGE * total * np.eye(m), b[:m])


def _chosen(Y, V, areas, n, most: int) -> tuple[int, dict[int, float]]:
    """The degree by cross-validation over blocks of neighbours, and the error of each."""
    rng = np.random.default_rng(0)
    n_blocks = max(len(V) // IN_A_BLOCK, PARTS)
    block = KDTree(n[rng.choice(len(n), n_blocks, replace=False)]).query(n)[1]
    part = (rng.permutation(n_blocks) % PARTS)[block]
    squares = np.zeros((PARTS, most + 1))
    G, b = _normal_equations(Y, V, areas)
    for k in range(PARTS):
        out = part == k
        G_out, b_out = _normal_equations(Y[out], V[out], areas[out])
        for L in range(1, most + 1):
            c = _solved(G - G_out, b - b_out, L, areas.sum())
            miss = np.sum((Y[out, : len(c)] @ c - V[out]) ** 2, axis=1)
            squares[k, L] = areas[out] @ miss / areas[out].sum()
    mean = squares.mean(axis=0)[1:]
    error = squares.std(axis=0, ddof=1)[1:] / np.sqrt(PARTS)
    best = int(np.argmin(mean))
    L = 1 + int(np.argmax(mean <= mean[best] + error[best]))
    return L, {1 + k: float(np.sqrt(value)) for k, value in enumerate(mean)}


def _area_and_volume(V, F) -> tuple[float, float]:
    a, b, c = (V[F[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    return 0.5 * float(np.linalg.norm(cross, axis=1).sum()), float(np.sum(a * np.cross(b, c))) / 6


@eqx.filter_jit
def _measured(mesh: SurfaceMesh, x):
    return area(mesh, x), volume(mesh, x)


def _checked_image(mesh: SurfaceMesh, x, L: int) -> tuple[float, float]:
    """Area and volume of the mapped icosphere.

    **Raises:** `ValueError` where it folds.
    """
    vertices = np.asarray(x)[: mesh.n_vertices]
    report = check_surface(vertices, np.asarray(mesh.triangles))
    if not report.ok:
        raise ValueError(
            f"the surface by harmonics of degree {L} is no surface: {report.findings[0].message} "
            "Choose a lower `max_degree` or a higher `level`."
        )
    A, volume_ = _measured(mesh, x)
    return float(A), float(volume_)

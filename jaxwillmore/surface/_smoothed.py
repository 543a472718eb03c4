r"""A smooth surface near measured points: short waves are taken off, whatever the genus."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float, Int
from scipy.sparse.linalg import splu

from ..fem import mass_and_stiffness, rule_for
from ..mesh import (
    SurfaceError,
    SurfaceMesh,
    check_mesh,
    check_surface,
    feet,
    raise_degree,
    remesh,
    scatter,
)
from ..reference import lagrange_basis
from ._conformal import stiffness, vertex_areas
from ._measures import area
from ._restore import LARGEST, restored

# Steps on the triangles that were measured, and as many on the new ones; the surface that comes out
# of a step makes the matrices of the next.
STEPS = 3
# (2πℓ/λ)⁴ at the wavelength: a wave that loses so much in each of six steps is halved by them.
HALVED = 2 ** (1 / (2 * STEPS)) - 1
# Edges of the new triangles, over the wavelength.
EDGE = 0.25
# The wavelength left out: so many times √(R s), and at least so many mean distances of vertices.
TERRACES, FEWEST = 11.5, 4.0
# It is at most so many times R, or the surface falls together.
WIDEST = 1.6
# Noise of label images over the mean distance of vertices, for meshes whose noise is not told.
LABELS = 0.12


class _Surface(NamedTuple):
    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]


class SmoothedSurface(_Surface):
    r"""The pair `(mesh, x)` of a smoothed surface, and what was done to it.

    **Attributes:**

    - `wavelength`: waves of this length were halved, length.
    - `rms`, `largest`: distance of the measured vertices from the surface, length.
    - `area_change`: of the surface, over that of the triangles, less one; its volume is theirs.
    """

    wavelength: float
    rms: float
    largest: float
    area_change: float

    def in_words(self) -> str:
        """One sentence for a log."""
        return (
            f"by fairing, waves of {self.wavelength:.3g} halved: rms distance of the vertices "
            f"{self.rms:.3g}, largest {self.largest:.3g}; area {self.area_change:+.2%} of the "
            "triangles', volume as theirs"
        )


def smoothed(
    vertices: Float[Array | np.ndarray, "vertices 3"],
    faces: Int[Array | np.ndarray, "faces 3"],
    wavelength: float | None = None,
    *,
    degree: int = 2,
) -> SmoothedSurface:
    r"""A smooth surface on a clean mesh for a measured one of any genus, with its volume.

    Implicit steps of the bi-Laplacian,

    $$ (M + \ell^4 S M^{-1} S)\, y = M x, $$

    divide a wave of the length λ by $1 + (2\pi\ell/\lambda)^4$: three on the triangles that were
    measured, which are then replaced by nearly equilateral ones of edge $\lambda/4$, and three with
    finite elements of the wanted degree on these. Together they halve waves of the length
    `wavelength`, leave 96 % of those twice as long and 0.15 % of those half as long. At last the
    surface is moved along its normals until it encloses the volume of the triangles.

    Measured on label images of a ball and a torus of 6 voxels, H of flat triangles: three steps
    with waves of 8 voxels leave an error of 7 to 10 %, one step with the matrices of the staircase
    35 to 57 %, a hundred of Taubin's λ|μ filter 140 to 280 %. Compare with `spherical`
    (`benchmarks/measured_surfaces.py`): H is mostly nearer to the truth here, the volume there. A
    ball of 6 voxels in the very middle of a voxel, whose steps repeat six-fold, has ½∫H² 0.4 % too
    high here, 29 % by harmonics.

    **Arguments:**

    - `vertices`, `faces`: a closed triangle mesh, normals out, any unit.
    - `wavelength`: of the waves that are halved, in the unit of the vertices. Left out, it is
      $11.5\sqrt{Rs}$, at most 1.6 R and at least four mean distances of vertices: R is three times
      the volume over the area, s the noise that `mesh.scatter` finds, or that of a label image
      where it cannot tell. Steps of a height s on a surface of radius R make terraces as wide as
      $\sqrt{Rs}$; for label images this is 3.5 times $\sqrt{R}$ in voxels.
    - `degree`: of the finite elements, 1 to 4.

    **Returns:** a `SmoothedSurface`, which is the pair `(mesh, x)`, x in the unit of the vertices.

    *Limits:* what is smaller than the wavelength is lost, details of the shape as well: necks and
    rims thinner than it are rounded. Creases are not kept.

    **Raises:** `mesh.SurfaceError` for a mesh that is not closed; `ValueError` for a wavelength
    that is not positive, is below four mean distances of vertices, or is so long that the surface
    folds or would have to move by 5 % of its size to have its volume back; and for a surface that
    still crosses itself after it.

    ??? cite "Reference"
        Desbrun, Meyer, Schröder, Barr (1999), *SIGGRAPH*, 317–324 (implicit fairing, with volume);
        Botsch, Kobbelt (2004), *Symposium on Geometry Processing*, 185–192 (the new triangles).

    ```python
    mesh, x = jw.surface.smoothed(vertices, faces, 8.0)  # a label image in voxels
    ```
    """
    if isinstance(degree, bool) or degree not in (1, 2, 3, 4):
        raise ValueError(f"`degree` must be 1, 2, 3 or 4; got {degree!r}.")
    V, F = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    report = check_surface(V, F, self_intersections=False)
    if not report.ok:
        raise SurfaceError(f"Only a closed surface of one piece can be smoothed. {report}", report)
    assert report.area is not None and report.volume is not None
    h = math.sqrt(report.area / len(V))
    length = _checked_wavelength(V, F, wavelength, h, 3 * report.volume / report.area)
    mesh, x = _faired_mesh(V, F, length, degree, report.volume)
    try:
        x = restored(mesh, x, volume=report.volume)
    except ValueError as error:
        raise ValueError(f"{_too_long(length)} {error}") from error
    _refuse_folds(mesh, x, length)
    found = SmoothedSurface(mesh, x)
    distance = _distances(mesh, np.asarray(x), V)
    found.wavelength, found.largest = length, float(distance.max())
    found.rms = float(np.sqrt(np.mean(distance**2)))
    found.area_change = float(eqx.filter_jit(area)(mesh, x)) / report.area - 1
    return found


def _checked_wavelength(V, F, wavelength: float | None, h: float, R: float) -> float:
    """The wavelength, chosen by size and noise if it is not given."""
    if wavelength is None:
        noise = scatter(F, V)
        s = LABELS * h if noise is None else noise.position
        return max(min(TERRACES * math.sqrt(R * s), WIDEST * R), FEWEST * h)
    if not (math.isfinite(wavelength) and wavelength >= FEWEST * h * (1 - 1e-9)):
        raise ValueError(
            f"`wavelength` must be at least {FEWEST * h:.3g}, {FEWEST:g} mean distances of the "
            f"vertices, which tell no shorter waves; got {wavelength}."
        )
    return float(wavelength)


def _faired_mesh(
    V, F, wavelength: float, degree: int, enclosed: float
) -> tuple[SurfaceMesh, Array]:
    """The surface on new triangles, smoothed before and after they are made."""
    strength = HALVED * (wavelength / (2 * math.pi)) ** 4
    for _ in range(STEPS):
        V = _solved(sp.diags(vertex_areas(V, F)), stiffness(V, F), strength, V)
    flat = SurfaceMesh(F, 1, len(V))
    _refuse_collapse(V, F, wavelength, enclosed)
    try:
        new = remesh(flat, V, EDGE * wavelength)
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"{_too_long(wavelength)} {error}") from error
    mesh, x = raise_degree(new.mesh, new.x, degree)
    for _ in range(STEPS):
        M, S = _matrices(mesh, x)
        x = jnp.asarray(_solved(M, S, strength, np.asarray(x)))
    return mesh, x


def _refuse_collapse(V, F, wavelength: float, enclosed: float) -> None:
    """New triangles of a surface that fell together would take long to fail."""
    report = check_surface(V, F, self_intersections=False)
    if report.ok and report.area is not None and report.volume is not None:
        moved = abs(enclosed - report.volume) / report.area
        if moved <= LARGEST * math.sqrt(report.area / (4 * math.pi)):
            return
    raise ValueError(
        f"{_too_long(wavelength)} To have its volume back the surface would move by more than "
        f"{LARGEST:.0%} of its size."
    )


def _solved(M, S, strength: float, x: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "nodes 3"]:
    r"""One step, with $w = \ell^2 M^{-1} S y$ as a second unknown instead of an inverse."""
    coupling = math.sqrt(strength) * S
    both = sp.bmat([[M, coupling], [-coupling, M]]).tocsc()
    return splu(both).solve(np.concatenate([M @ x, np.zeros_like(x)]))[: len(x)]


def _matrices(mesh: SurfaceMesh, x):
    """Mass and stiffness of finite elements as sparse matrices."""
    cells = np.asarray(mesh.cells)
    rows, columns = np.repeat(cells, cells.shape[1], axis=1), np.tile(cells, (1, cells.shape[1]))
    place, shape = (rows.ravel(), columns.ravel()), (mesh.n_nodes, mesh.n_nodes)
    return (
        sp.csc_matrix((np.asarray(local).ravel(), place), shape=shape)
        for local in _local_matrices(mesh, x)
    )


@eqx.filter_jit
def _local_matrices(mesh: SurfaceMesh, x):
    return mass_and_stiffness(mesh, rule_for(mesh), x)


def _refuse_folds(mesh: SurfaceMesh, x, wavelength: float) -> None:
    report = check_mesh(mesh, x)
    bad = [f for f in report.findings if f.severity == "error" or f.kind == "self_intersections"]
    if bad:
        raise ValueError(f"{_too_long(wavelength)} {bad[0].message}")


def _too_long(wavelength: float) -> str:
    return (
        f"The wavelength {wavelength:.3g} is too long for this surface, or the surface crosses or "
        "touches itself: choose a shorter one, or repair the mesh; `mesh.check_surface` tells "
        "where."
    )


def _distances(mesh: SurfaceMesh, x, points) -> Float[np.ndarray, " points"]:
    found = feet(np.asarray(mesh.cells), x, points)
    nodes = x[np.asarray(mesh.cells)[found.cell]]
    nearest = np.einsum("pl,pld->pd", lagrange_basis(mesh.degree, found.xi), nodes)
    return np.linalg.norm(points - nearest, axis=1)

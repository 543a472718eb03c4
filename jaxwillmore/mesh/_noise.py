r"""How rough measured positions are, and how much of a bending energy that makes.

The height of a vertex is compared with a polynomial of degree four through its neighbours and
theirs. On a smooth surface the two agree up to O(h⁵); what is left is noise of the positions.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._adjacency import Triangles
from ._quality import areas
from ._stencils import powers, stencils

# Independent errors s of vertices with areas A_i make ½∫H² larger by 21 s² Σ 1/A_i, on flat
# triangles and on those of degree two alike (measured on spheres, within a fifth).
EXCESS = 21.0
# The curvature by cotangents has less of it.
OF_COTANGENTS = 1 / 3
# Coarse meshes do not tell: so much of the vertices must have a fit, which may multiply the errors
# of its neighbours by so much.
LEAST_PART, MOST_LEVERAGE = 0.8, 2.3
# So many vertices are enough for an estimate.
ENOUGH = 10_000
# Residuals beyond this part are those of edges and folds; a normal distribution has lost so much.
KEPT, LOST = 0.95, 0.759


class Scatter(NamedTuple):
    """Roughness of the positions of a triangulation.

    **Attributes:**

    - `position`: standard deviation along the normals, a length.
    - `relative`: that over the mean distance of vertices.
    - `energy`: ½∫H² that it makes in finite elements.
    - `smooth`: ½∫H² that is left without it.
    """

    position: float
    relative: float
    energy: float
    smooth: float

    @property
    def share(self) -> float:
        """The part of ½∫H² that is noise."""
        return self.energy / (self.energy + self.smooth)

    def __str__(self) -> str:
        return (
            f"positions scatter by {self.relative:.2g} of the distance of vertices: about "
            f"{self.share:.1%} of ½∫H² = {self.energy + self.smooth:.4g} is noise"
        )


def scatter(triangles: Triangles, x: Float[np.ndarray, "vertices 3"]) -> Scatter | None:
    """The roughness of a closed triangulation; `None` where it is too coarse to tell."""
    near = stencils(triangles, x).every(-(-len(x) // ENOUGH))
    columns = np.concatenate([np.ones((len(near.u), 1)), powers(near.u, near.v)], axis=1)
    moments = near.moments(np.concatenate([columns, near.w[:, None]], axis=1))
    matrix, right = moments[:, :15, :15], moments[:, :15, 15]
    spectrum = np.linalg.eigvalsh(matrix)
    told = spectrum[:, 0] > 1e-8 * spectrum[:, -1]
    told &= np.bincount(near.at, minlength=len(told)) > 15
    if np.mean(told) < LEAST_PART:
        return None
    # The value of the fit at the vertex is this combination of the heights of the neighbours.
    first = np.linalg.inv(matrix[told])[:, 0]
    leverage = first[:, 0]
    if np.median(leverage) > MOST_LEVERAGE:
        return None
    missing = np.sum(first * right[told], axis=1) * near.reach[told] / np.sqrt(1 + leverage)
    squares = np.sort(missing**2)
    variance = float(np.mean(squares[: max(int(KEPT * len(squares)), 1)])) / LOST
    noise = float(np.sqrt(variance))
    energy, flat = excess_energy(noise, triangles, x), flat_willmore(triangles, x)
    relative = noise / float(np.sqrt(np.mean(vertex_areas(triangles, x))))
    return Scatter(noise, relative, energy, max(flat - OF_COTANGENTS * energy, 1e-3 * flat))


def rounding(x: Float[np.ndarray, "vertices 3"]) -> float:
    """Standard deviation of the last digit of single precision, 0 where more digits are there."""
    single = x.astype(np.float32)
    if not np.array_equal(single.astype(np.float64), x):
        return 0.0
    return float(np.sqrt(np.mean(np.spacing(np.abs(single)).astype(np.float64) ** 2) / 12))


def excess_energy(error: float, triangles: Triangles, x: Float[np.ndarray, "vertices 3"]) -> float:
    """How much larger independent errors of the vertices make ½∫H²."""
    return EXCESS * float(error) ** 2 * float(np.sum(1 / vertex_areas(triangles, x)))


def vertex_areas(
    triangles: Triangles, x: Float[np.ndarray, "vertices 3"]
) -> Float[np.ndarray, " vertices"]:
    """A third of the area of the triangles around every vertex."""
    of_cells = areas(x[triangles])
    return np.bincount(triangles.ravel(), np.repeat(of_cells / 3, 3), minlength=len(x))


def flat_willmore(triangles: Triangles, x: Float[np.ndarray, "vertices 3"]) -> float:
    r"""½∫H² of flat triangles, $\tfrac12\sum_i |\sum_j w_{ij}(x_i - x_j)|^2/A_i$ by cotangents.

    ??? cite "Reference"
        Meyer, Desbrun, Schröder, Barr (2003), *Visualization and Mathematics III*, 35–57, (8).
    """
    force = np.zeros_like(x)
    for corner in range(3):
        i, j, k = (triangles[:, (corner + m) % 3] for m in range(3))
        a, b = x[i] - x[k], x[j] - x[k]
        cotangent = np.sum(a * b, axis=1) / np.linalg.norm(np.cross(a, b), axis=1)
        pull = 0.5 * cotangent[:, None] * (x[i] - x[j])
        np.add.at(force, i, pull)
        np.add.at(force, j, -pull)
    return float(0.5 * np.sum(np.sum(force**2, axis=1) / vertex_areas(triangles, x)))

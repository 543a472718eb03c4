"""Is the mesh still evidence? Measures of a curved mesh that corner angles do not see."""

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from ..fem import rule_for
from ..mesh import SurfaceMesh, quality

MIN_ANGLE = 8.0
MAX_OFFSET = 0.2
MIN_JACOBIAN = 0.05


@dataclasses.dataclass(frozen=True)
class MeshHealth:
    """Worst values over all elements of a curved mesh."""

    min_angle: float
    """Smallest corner angle, degrees."""
    mid_node_offset: float
    """Largest displacement along its edge of a node inside an edge, in edge lengths."""
    min_jacobian: float
    """Smallest area element over the mean one of its cell; below 0 the cell folds."""

    @property
    def is_sound(self) -> bool:
        """Whether equilibria on this mesh are to be believed."""
        return (
            self.min_angle > MIN_ANGLE
            and self.mid_node_offset < MAX_OFFSET
            and self.min_jacobian > MIN_JACOBIAN
        )


def mesh_health(mesh: SurfaceMesh, x: Float[Array | np.ndarray, "nodes 3"]) -> MeshHealth:
    """Measure a mesh; NumPy, on the host."""
    nodes = np.asarray(x)
    if not np.all(np.isfinite(nodes)):
        return MeshHealth(0.0, np.inf, -np.inf)
    local = nodes[np.asarray(mesh.cells)]
    return MeshHealth(
        quality(mesh, nodes).min_angle, _offset(local, mesh.degree), _jacobian(mesh, local)
    )


def _offset(local, degree: int) -> float:
    worst = 0.0
    for edge in range(3):
        a, b = local[:, edge], local[:, (edge + 1) % 3]
        along = b - a
        length2 = np.sum(along**2, axis=1)
        for k in range(degree - 1):
            node = local[:, 3 + edge * (degree - 1) + k]
            place = np.sum((node - a) * along, axis=1) / np.maximum(length2, 1e-300)
            worst = max(worst, float(np.max(np.abs(place - (k + 1) / degree))))
    return worst


def _jacobian(mesh, local) -> float:
    phi = np.asarray(rule_for(mesh, min(2 * mesh.degree + 2, 10)).phi)
    J = np.einsum("qjd,tji->tqdi", phi[:, :, 1:], local)
    cross = np.cross(J[:, :, 0], J[:, :, 1])
    mean = cross.mean(axis=1, keepdims=True)
    size = np.linalg.norm(mean, axis=-1)
    along = np.sum(cross * mean, axis=-1) / np.maximum(size, 1e-300)
    return float(np.min(along / np.maximum(size, 1e-300)))

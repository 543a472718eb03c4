"""How much memory the search of an equilibrium takes, before it begins."""

from ..linalg import checked_method, system_bytes
from ..mesh import SurfaceMesh
from ._functional import N_GLOBALS

# Python, JAX, the libraries and the compiled functions of a solve.
PROCESS = 600_000_000
# Numbers per unknown and node: reference surface, iterates, Lanczos vectors.
VECTORS = 40


def memory_estimate(
    mesh: SurfaceMesh, *, two_phase: bool = False, linear_solver: str = "direct"
) -> int:
    """Bytes that the process of `equilibrium` has at its peak, within a fifth or so.

    **Arguments:**

    - `two_phase`: whether the concentration is among the unknowns.
    - `linear_solver`: as of `equilibrium`.

    **Raises:** `ValueError` for a method that is none, or not for so many unknowns.
    """
    fields, n_globals = 4 + two_phase, N_GLOBALS + two_phase
    checked_method(linear_solver, mesh.n_nodes * fields + n_globals)
    system = system_bytes(mesh.n_nodes, mesh.n_node_pairs, fields, (), linear_solver, n_globals)
    # Cell matrices stand beside the blocks they are added to.
    cells = 8 * fields**2 * mesh.cells.shape[1] ** 2 * mesh.n_cells
    return PROCESS + system + cells + 8 * VECTORS * fields * mesh.n_nodes

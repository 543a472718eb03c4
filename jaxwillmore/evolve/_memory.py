"""How much memory a run takes, before it begins."""

from ..flows import AbstractLaw, System, as_system
from ..linalg import checked_method, system_bytes
from ..mesh import SurfaceMesh
from ._stepper import column_groups

# Python, JAX, the libraries and the compiled functions of a step.
PROCESS = 600_000_000
# Numbers per unknown and node: history, extrapolations, basis of GMRES, temporaries.
VECTORS = 40
# Bytes per pair of nodes of a cell: where it adds to, and the sums over cells.
PAIR = 48


def memory_estimate(
    flow: System | AbstractLaw, mesh: SurfaceMesh, *, linear_solver: str = "krylov"
) -> int:
    """Bytes that the process of a run has at its peak, within a fifth or so.

    What the run saves comes on top: `saveat` keeps nodes and fields of every state in memory.

    **Arguments:**

    - `flow`, `mesh`, `linear_solver`: as of `evolve`.

    **Raises:** `ValueError` for a method that is none, or not for so many unknowns.

    ```python
    mesh, _ = jw.mesh.icosphere(level=6, degree=2)  # 163,842 nodes
    jw.evolve.memory_estimate(jw.flows.WillmoreFlow(), mesh) / 1e9  # 4.5 GB
    ```
    """
    flow = as_system(flow)
    width = flow.layout.width
    checked_method(linear_solver, mesh.n_nodes * width + flow.n_globals)
    groups = column_groups(flow.layout, flow.stages)
    system = system_bytes(
        mesh.n_nodes, mesh.n_node_pairs, width, groups, linear_solver, flow.n_globals
    )
    local = mesh.cells.shape[1]
    cells = PAIR * local**2 * mesh.n_cells
    return PROCESS + system + cells + 8 * VECTORS * width * mesh.n_nodes

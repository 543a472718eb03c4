"""refined: the same equilibrium on a finer mesh, from the coarse one."""

import time

from .._machine import checked_memory
from ..mesh import prolongate, refine
from ._density import PATH
from ._equilibrium import concluded
from ._functional import concentration
from ._memory import memory_estimate
from ._relax import Ended, Relaxation, relax, settle
from ._results import RESULTS
from ._shape import Equilibrium


def refined(
    equilibrium: Equilibrium,
    *,
    tolerance: float = 1e-10,
    max_outer: int = 60,
    stability: bool = True,
    linear_solver: str = "direct",
    throw: bool = True,
) -> Equilibrium:
    r"""The equilibrium with the same parameters on a mesh with four triangles for each.

    The coarse shape, its moment $Y$, its concentration and its multipliers are functions on the
    finer mesh too and start Newton's method there; a handful of iterations are left to do. A fine
    equilibrium by way of coarse ones costs a fraction of one from a poor start, and the differences
    between levels show the discretisation error.

    **Arguments:** those of the same names of `equilibrium`; `max_outer` counts the pseudo-time
    steps that are taken should Newton's method not reach the fine shape at once.

    **Raises:** `ValueError` for a start that has not converged; `RuntimeError`.

    ```python
    mesh, x = jw.equilibria.spheroid(0.8, level=1)
    shapes = [jw.equilibria.equilibrium(mesh, x, reduced_volume=0.8)]  # 162 nodes
    for _ in range(2):
        shapes.append(jw.equilibria.refined(shapes[-1]))  # 642 and 2,562
    ```
    """
    started = time.perf_counter()
    if not equilibrium.succeeded:
        raise ValueError("Only an equilibrium that converged can be refined; look at `result`.")
    coarse, units = equilibrium.mesh, equilibrium.units
    mesh, X = refine(coarse, units.inward(equilibrium.x))
    checked_memory(
        memory_estimate(mesh, two_phase=equilibrium.c is not None, linear_solver=linear_solver),
        f"The finer equilibrium on {mesh.n_nodes:,} nodes",
    )
    target = units.parameters(equilibrium.parameters)
    flags = equilibrium.fixed_area, equilibrium.fixed_volume
    relaxation = Relaxation(mesh, flags, tolerance, linear_solver)
    fields, g = equilibrium.nodal_unknowns
    y = prolongate(coarse, fields)
    # The path parameter of a branch is not one here.
    g = g.at[PATH].set(0.0)
    system = relaxation.system(relaxation.reference(X, concentration(y)), target)
    found = settle(relaxation, system, y, g)
    if found is None:
        ended = relax(relaxation, X, target, max_outer, None, concentration(y))
    else:
        ended = Ended(*found, RESULTS.converged, 0)
    search = equilibrium.stats.get("search", "stationary")
    return concluded(relaxation, ended, X, units, stability, throw, started, search)

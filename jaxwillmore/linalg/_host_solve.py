"""solve_on_host: drives `HostNewton` as Optimistix drives its solvers, without a trace."""

import dataclasses

import numpy as np
import optimistix as optx

from ._host_matrix import HostMatrix
from ._host_newton import HostNewton
from ._host_system import HostSolution, HostSystem
from ._threads import one_blas_thread


def solve_on_host(
    solver: HostNewton,
    system: HostSystem,
    y0: np.ndarray,
    f0: np.ndarray | None = None,
    kept: HostMatrix | None = None,
    max_steps: int = 12,
) -> HostSolution:
    """The root of a `HostSystem`, found outside any traced function.

    OpenBLAS works on one thread meanwhile, in `system` too.

    **Arguments:**

    - `y0`, `f0`: the start, and its residual if it is known.
    - `kept`: `HostSolution.kept` of a nearby system. It belongs to the solve from here on, which
      frees it when it makes a new one. A solve that fails with it begins again without it.
    - `max_steps`: Newton iterations before it is given up.

    **Raises:** nothing; see `HostSolution.result`.
    """
    y0 = np.asarray(y0, float)
    with one_blas_thread():
        evaluated = f0 is None
        f0 = _residual(y0, system)[0] if f0 is None else np.asarray(f0, float)
        solution, inherited = _drive(solver, system, y0, f0, kept, max_steps)
        if inherited and not _is_success(solution):
            again, _ = _drive(solver, system, y0, f0, None, max_steps)
            solution = _added(again, solution)
    return dataclasses.replace(solution, residuals=solution.residuals + evaluated)


def _residual(y, system):
    # A step too far may overflow: its residual is not finite, and the step is halved.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return np.asarray(system.residual(y), float), None


def _is_success(solution: HostSolution) -> bool:
    return bool(solution.result == optx.RESULTS.successful)


def _drive(solver, system, y, f, kept, max_steps) -> tuple[HostSolution, bool]:
    tags = frozenset()
    options = {"f": f, "kept": kept}
    state = solver.init(_residual, y, system, options, None, None, tags)
    while True:
        y, state, aux = solver.step(_residual, y, system, options, state, tags)
        stop, result = solver.terminate(_residual, y, system, options, state, tags)
        if stop:
            break
        if state.iterations >= max_steps and state.schur is None:
            result = optx.RESULTS.nonlinear_max_steps_reached
            break
    y, _, counts = solver.postprocess(_residual, y, aux, system, options, state, tags, result)
    solution = HostSolution(y=y, f=state.f, result=result, kept=state.matrix, **counts)
    if not _is_success(solution):
        state.matrix.release()
        solution = dataclasses.replace(solution, kept=None)
    return solution, state.inherited


def _added(solution: HostSolution, failed: HostSolution) -> HostSolution:
    """With the work of the attempt that failed."""
    names = [f.name for f in dataclasses.fields(HostSolution) if f.type is int]
    return dataclasses.replace(
        solution, **{name: getattr(solution, name) + getattr(failed, name) for name in names}
    )

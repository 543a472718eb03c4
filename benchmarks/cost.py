"""What a Newton iteration is made of, in multiples of one residual evaluation.

    python benchmarks/cost.py [--full]

CPU seconds of this process, pinned to one core (so that XLA, SuperLU and MKL all use one thread),
best of several calls, compilation excluded: residual and Jacobian by the plan that runs use. The
matrix is the Jacobian of the second step of a red cell's relaxation: 8 fields per node. `--full`
adds 10,242 nodes (ten minutes).
"""

import argparse
import importlib.util
import os
import resource
import time

os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import jax
import jax.numpy as jnp
import numpy as np

import jaxwillmore as jw
from jaxwillmore.evolve._host_step import HostStep, StepOnHost, _prepare
from jaxwillmore.evolve._step import ImplicitStep
from jaxwillmore.evolve._stepper import weights
from jaxwillmore.linalg import HostMatrix
from jaxwillmore.linalg._direct import ColumnStructure, Pattern, SuperLU
from jaxwillmore.linalg._host_newton import FORCING
from jaxwillmore.linalg._krylov import GaussSeidel
from jaxwillmore.verify import format_table

DT = 1e-3
# As of a run with rtol = 1e-3.
TOLERANCE = 1e-5


def best(call, repeats: int) -> float:
    """Smallest CPU time of several calls."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        jax.block_until_ready(call())
        times.append(time.process_time() - began)
    return min(times)


def second_step(degree: int, level: int):
    """The stepper, its second step as the host's Newton sees it, and the start of the iteration."""
    mesh, x = jw.mesh.red_cell(level=level, degree=degree)
    exact = jw.surface.RedCell()
    stepper = jw.evolve.Stepper(jw.flows.WillmoreFlow(), mesh)
    host = HostStep(stepper, TOLERANCE)
    fields = {"H": exact.mean_curvature(x), "nu": exact.normal(x)}
    history = stepper.start(jnp.asarray(0.0), x, fields, 3)
    t = jnp.asarray(DT)
    first = host(history, weights(history.times, t, 1, 2), t)
    history = history.push(t, first.x, first.U, first.amounts, first.multipliers)
    t = jnp.asarray(2 * DT)
    w = weights(history.times, t, 2, 2)
    data, y = _prepare(stepper, history, w, t)
    system = StepOnHost(host, ImplicitStep(stepper.problem, data))

    def whole():
        host._kept = None  # no Jacobian from the step before
        return host(history, w, t)

    return stepper, system, np.asarray(y), whole


def pardiso(structure: ColumnStructure, data: np.ndarray, repeats: int) -> dict:
    """Analysis, factorisation, solve and memory of MKL Pardiso, if it is installed."""
    if importlib.util.find_spec("pypardiso") is None:
        return {}
    from pypardiso import PyPardisoSolver

    matrix = structure.matrix(data).tocsr()
    matrix.sort_indices()
    solver, rhs = PyPardisoSolver(), np.ones(matrix.shape[0])

    def phase(number):
        solver.set_phase(number)
        solver._call_pardiso(matrix, rhs)

    row = {"pardiso_analyse": best(lambda: phase(11), 1)}
    row["pardiso_factor"] = best(lambda: phase(22), repeats)
    row["pardiso_solve"] = best(lambda: phase(33), repeats)
    # iparm(16) + iparm(17), kilobytes: permanent memory of analysis and factors.
    row["pardiso_mb"] = (solver.get_iparm(16) + solver.get_iparm(17)) / 1024
    solver.free_memory(everything=True)
    return row


def direct(structure: ColumnStructure, data: np.ndarray, repeats: int) -> dict:
    """SuperLU of the whole matrix in nested-dissection order."""
    made = []
    row = {"superlu_factor": best(lambda: made.append(SuperLU(structure, data)), repeats)}
    return row | {"superlu_mb": made[-1].nbytes / 2**20}


def costs(degree: int, level: int, superlu: bool) -> dict:
    """All costs at one mesh, in CPU seconds and megabytes, as a row."""
    stepper, system, y, whole = second_step(degree, level)
    n_nodes = stepper.problem.mesh.n_nodes
    repeats = 5 if n_nodes < 5000 else 2
    f, (data, _) = system.residual(y), system.jacobian(y)
    row = {"degree": degree, "nodes": n_nodes}
    row["residual"] = best(lambda: system.residual(y), 4 * repeats)
    row["jacobian"] = best(lambda: system.jacobian(y)[0], repeats)
    row["jacobian_mb"] = data.nbytes / 2**20

    p = system.pattern
    pattern = Pattern(*(np.asarray(a) for a in (p.indptr, p.cols, p.rows, p.order)))
    groups = system.groups
    sizes = {len(group[0]) for group in groups} | {data.shape[1]}
    structures = {n: ColumnStructure(pattern, n) for n in sizes}
    sweeps = []

    def setup():
        sweeps[:] = [GaussSeidel(pattern, data, groups, structures.__getitem__, SuperLU)]

    row["setup"] = best(setup, repeats)
    row["setup_mb"] = sweeps[0].nbytes / 2**20
    matrix = HostMatrix(p, data, None, groups)
    row["iterations"] = matrix.solve(f, FORCING)[1]
    row["krylov"] = best(lambda: matrix.solve(f, FORCING)[0], repeats)
    row["newton"] = row["residual"] + row["jacobian"] + row["setup"] + row["krylov"]
    matrix.release()

    attempt = whole()
    row["step"] = best(lambda: whole().x, 2)
    row["newton_iterations"] = int(attempt.newton_iterations)
    row["jacobians"] = int(attempt.jacobians)
    row |= pardiso(structures[data.shape[1]], data, repeats)
    if superlu:
        row |= direct(structures[data.shape[1]], data, 1)
    row["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return row


SECONDS = {
    "degree": "degree",
    "nodes": "nodes",
    "residual": "residual",
    "jacobian": "Jacobian",
    "setup": "setup",
    "iterations": "its",
    "krylov": "Krylov",
    "newton": "iteration",
    "step": "whole step",
    "newton_iterations": "Newton",
    "jacobians": "Jacobians",
    "superlu_factor": "SuperLU",
    "pardiso_analyse": "Pardiso analysis",
    "pardiso_factor": "factorisation",
    "pardiso_solve": "solve",
}
MEMORY = {
    "degree": "degree",
    "nodes": "nodes",
    "jacobian_mb": "Jacobian",
    "setup_mb": "preconditioner",
    "superlu_mb": "SuperLU",
    "pardiso_mb": "Pardiso",
    "peak_mb": "process so far",
}
COUNTS = ("degree", "nodes", "iterations", "newton_iterations", "jacobians")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="10,242 nodes as well")
    full = parser.parse_args().full
    levels = [(1, 3), (2, 2), (1, 4), (2, 3)] + ([(1, 5), (2, 4)] if full else [])
    rows = [costs(degree, level, True) for degree, level in levels]
    multiples = [
        {k: v if k in COUNTS else v / row["residual"] for k, v in row.items()} for row in rows
    ]
    print("CPU seconds")
    print(format_table(rows, SECONDS))
    print("\nMultiples of one residual evaluation")
    print(format_table(multiples, SECONDS))
    print("\nMegabytes")
    print(format_table(rows, MEMORY))
    last = [row for row in rows if row["nodes"] == max(r["nodes"] for r in rows)]
    for row in last:
        if "pardiso_factor" in row:
            print(
                f"P{row['degree']} with {row['nodes']} nodes: a Newton iteration with a new "
                f"Jacobian costs {row['newton'] / row['pardiso_factor']:.2f} times one Pardiso "
                "factorisation of the same matrix, analysis not counted; an iteration of the step, "
                f"which makes {row['jacobians']} Jacobian in {row['newton_iterations']}, "
                f"{row['step'] / row['newton_iterations'] / row['pardiso_factor']:.2f} times."
            )


if __name__ == "__main__":
    main()

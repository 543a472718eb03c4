"""What a Newton iteration is made of, in multiples of one residual evaluation.

    python benchmarks/cost.py [--full]

CPU seconds of this process, pinned to one core (so that XLA, SuperLU and MKL all use one thread),
best of several calls, compilation excluded. The matrix is the Jacobian of the second step of a red
cell's relaxation: 8 fields per node. `--full` adds 10,242 nodes (about ten minutes, 6 GB).
"""

import argparse
import importlib.util
import os
import resource
import time

os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np

import jaxwillmore as jw
from jaxwillmore.evolve._step import ImplicitStep
from jaxwillmore.evolve._stepper import column_groups, weights
from jaxwillmore.linalg import SparseSolver
from jaxwillmore.linalg._direct import ColumnStructure, Pattern, SuperLU
from jaxwillmore.linalg._krylov import GaussSeidel
from jaxwillmore.verify import format_table

DT = 1e-3


def best(call, repeats: int) -> float:
    """Smallest CPU time of several calls."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        jax.block_until_ready(call())
        times.append(time.process_time() - began)
    return min(times)


def second_step(degree: int, level: int):
    """The step, the system of its Newton iteration and the start of it."""
    mesh, x = jw.mesh.red_cell(level=level, degree=degree)
    exact = jw.surface.RedCell()
    stepper = jw.evolve.Stepper(jw.flows.WillmoreFlow(), mesh)
    fields = {"H": exact.mean_curvature(x), "nu": exact.normal(x)}
    step = eqx.filter_jit(lambda s, h, w, t: s(h, w, t))
    history = stepper.start(jnp.asarray(0.0), x, fields, 3)
    first = step(stepper, history, weights(history.times, jnp.asarray(DT), 1, 2), jnp.asarray(DT))
    history = history.push(jnp.asarray(DT), first.x, first.U, first.multipliers)
    t = jnp.asarray(2 * DT)
    w = weights(history.times, t, 2, 2)
    system = ImplicitStep(stepper.problem, stepper._data(history, w, t))
    guess = system.pack(jnp.tensordot(w.guess, history.U, axes=1), jnp.zeros(0))
    return mesh, stepper, system, guess, lambda: step(stepper, history, w, t)


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
    # Value and row index of every entry of the factors.
    return row | {"superlu_mb": made[-1]._lu.nnz * 12 / 2**20}


def costs(degree: int, level: int, superlu: bool) -> dict:
    """All costs at one mesh, in CPU seconds and megabytes, as a row."""
    mesh, stepper, system, y, whole = second_step(degree, level)
    repeats = 5 if mesh.n_nodes < 5000 else 2
    residual = eqx.filter_jit(lambda s, y: s.residual(y))
    jacobian = eqx.filter_jit(lambda s, y: s.jacobian(y))
    f, operator = residual(system, y), jacobian(system, y)
    row = {"degree": degree, "nodes": mesh.n_nodes}
    row["residual"] = best(lambda: residual(system, y), 4 * repeats)
    row["jacobian"] = best(lambda: jacobian(system, y).data, repeats)
    row["jacobian_mb"] = operator.data.nbytes / 2**20

    p, data = operator.pattern, np.asarray(operator.data)
    pattern = Pattern(*(np.asarray(a) for a in (p.indptr, p.cols, p.rows, p.order)))
    flow = stepper.problem.flow
    groups = column_groups(flow.layout, flow.stages)
    sizes = {len(group[0]) for group in groups} | {data.shape[1]}
    structures = {n: ColumnStructure(pattern, n) for n in sizes}
    sweeps = []

    def setup():
        sweeps[:] = [GaussSeidel(pattern, data, groups, structures.__getitem__, SuperLU)]

    row["setup"] = best(setup, repeats)
    row["setup_mb"] = sum(lu._lu.nnz for lu in sweeps[0]._lus) * 12 / 2**20
    # The tolerance of the corrections of Newton's method.
    krylov = SparseSolver(groups, 1e-6)
    solve = eqx.filter_jit(lambda op, f: lx.linear_solve(op, f, krylov, throw=False))
    row["iterations"] = int(solve(operator, f).stats["iterations"])
    row["krylov"] = best(lambda: solve(operator, f).value, repeats) - row["setup"]
    row["newton"] = row["residual"] + row["jacobian"] + row["setup"] + row["krylov"]

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

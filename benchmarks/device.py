"""Many parameter sets at once, on whatever device JAX has; and what a device does for a large mesh.

    python benchmarks/device.py [--sets N] [--full]

First table: ten steps of Willmore flow with minimal deformation for N values of the bending modulus
on 42 nodes, on a GPU on 162 too (1,944 unknowns), as one program under `vmap` with the dense
solver, seconds per set without compilation, beside the same on the host's sparse solver one after
another. Second table: assembly of the residual and of the Jacobian's cell matrices by the compiled
plan on the default device, beside NumPy's run of the same plan on the host: 2,562 nodes, and up to
163,842 with `--full`. On a machine without a GPU both sides are the CPU.
"""

import argparse
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxwillmore as jw
from jaxwillmore.evolve._host_step import StepOnHost
from jaxwillmore.evolve._step import ImplicitStep
from jaxwillmore.evolve._stepper import weights
from jaxwillmore.fem import planned_cell_jacobians
from jaxwillmore.verify import format_table

TIMES = 1e-3 * np.array([0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])


def seconds(call, repeats: int = 3) -> float:
    """Least wall seconds of several calls, after one that compiles."""
    jax.block_until_ready(call())
    found = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(call())
        found.append(time.perf_counter() - began)
    return min(found)


def flow_of(bending_modulus):
    """Willmore flow with the tangential motion."""
    return jw.flows.System(jw.flows.WillmoreFlow(bending_modulus), jw.flows.MinimalDeformation())


def batch(level: int, n_sets: int) -> dict:
    """A batch of runs against a loop."""
    mesh, x = jw.mesh.red_cell(level=level, degree=2)

    def volume(b, method):
        run = jw.evolve.replay(flow_of(b), mesh, x, TIMES, linear_solver=method)
        return jnp.where(run.converged, jw.surface.volume(mesh, run.x[-1]), jnp.nan)

    moduli = jnp.linspace(0.4, 0.6, n_sets)
    together = jax.jit(jax.vmap(lambda b: volume(b, "dense")))
    alone = jax.jit(lambda b: volume(b, "krylov"))
    difference = jnp.max(jnp.abs(together(moduli)[0] - alone(moduli[0])))
    row = {"nodes": mesh.n_nodes, "sets": n_sets, "difference": float(difference)}
    row["batch"] = seconds(lambda: together(moduli)) / n_sets
    row["loop"] = seconds(lambda: alone(moduli[0]))
    return row | {"ratio": row["loop"] / row["batch"]}


def assembly(level: int) -> dict:
    """Residual and cell matrices of one step."""
    mesh, x = jw.mesh.red_cell(level=level, degree=2)
    stepper = jw.evolve.Stepper(flow_of(0.5), mesh)
    problem = stepper.problem
    start = problem.flow.start(mesh, x, {})
    history = stepper.start(jnp.asarray(0.0), x, start, 3)
    t = jnp.asarray(1e-4)
    w = eqx.filter_jit(weights)(history.times, t, 1, 2)
    data = eqx.filter_jit(lambda s, h, w: s.data(h, w, t))(stepper, history, w)
    system = ImplicitStep(problem, data)
    y = system.pack(history.U[0], history.multipliers[0])
    on_host = StepOnHost(jw.evolve._host_step.HostStep(stepper, 1e-5), system)
    residual = eqx.filter_jit(lambda s, y: s.residual(y))

    @eqx.filter_jit
    def cell_matrices(s, y):
        a, p = s.assembly(y), s.problem
        return planned_cell_jacobians(a.form, p.mesh, p.rule, a.x, a.U, a.Z, a.args, a.dx)

    z = np.asarray(y)
    row = {"nodes": mesh.n_nodes, "residual": seconds(lambda: residual(system, y))}
    row["residual_host"] = seconds(lambda: on_host.residual(z))
    row["jacobian"] = seconds(lambda: cell_matrices(system, y))
    row["jacobian_host"] = seconds(lambda: on_host.jacobian(z)[0])
    return row


def main(n_sets: int, full: bool):
    """Two tables."""
    print(f"device: {jax.devices()[0].device_kind} ({jax.default_backend()})\n")
    levels = (0,) if jax.default_backend() == "cpu" else (0, 1)
    rows = [batch(level, n_sets) for level in levels]
    print(format_table(rows, ["nodes", "sets", "batch", "loop", "ratio", "difference"]))
    print()
    rows = [assembly(level) for level in ((3, 4, 5, 6) if full else (3,))]
    columns = ["nodes", "residual", "residual_host", "jacobian", "jacobian_host"]
    print(format_table(rows, columns))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=16, help="parameter sets in a batch")
    parser.add_argument("--full", action="store_true", help="meshes of up to 163,842 nodes")
    arguments = parser.parse_args()
    main(arguments.sets, arguments.full)

"""What a gradient costs beside the run, or the equilibrium, that it is the gradient of.

    python benchmarks/gradient_cost.py [--full | --quick]

CPU seconds on one core, compilation excluded, the buffers of the compiled function and the peak
memory of the process, compiler included: every row is a process of its own. The number
differentiated is the Willmore energy plus a linear functional of the nodes at the end; reverse
mode by all of b_b, H0, the initial nodes and the times. `gradient` stands for value and gradient
together. The cost beyond the run is (gradient - run)/run, its target 1; for an equilibrium it is
(gradient - resolve)/equilibrium with the target 0.15. `--quick` stops at 162 nodes, `--full` goes
on to 1,000 steps and 2,562 nodes (hours).
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time

os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr

import jaxwillmore as jw
from jaxwillmore.verify import format_table, rough_sphere

TAU = 2e-4
WAYS = ("run", "gradient", "gradient, no checkpoints")


def spent(call):
    """CPU seconds of one call that is compiled already."""
    began = time.process_time()
    jax.block_until_ready(call())
    return time.process_time() - began


def trajectory_row(level: int, n_steps: int, way: str) -> dict:
    """One run, or its gradient, on a rough ellipsoid."""
    mesh, sphere = rough_sphere(level, 2)
    x = sphere * jnp.array([[1.0, 1.1, 1.3]])
    weights = jr.normal(jr.key(0), x.shape) / mesh.n_nodes
    stepper = jw.evolve.Stepper(jw.flows.WillmoreFlow(), mesh)

    def end(b, H0, x, times):
        run = jw.evolve.replay(
            jw.flows.WillmoreFlow(b, H0),
            mesh,
            x,
            times,
            stepper=stepper,
            checkpoint=way != "gradient, no checkpoints",
        )
        return jw.energies.Willmore()(mesh, run.x[-1]) + jnp.vdot(weights, run.x[-1])

    f = end if way == "run" else jax.value_and_grad(end, argnums=(0, 1, 2, 3))
    at = jnp.asarray(0.5), jnp.asarray(0.2), x, TAU * jnp.arange(n_steps + 1.0)
    began = time.process_time()
    compiled = jax.jit(f).lower(*at).compile()
    compile_seconds = time.process_time() - began
    if n_steps <= 100:
        # The first call also analyses the sparsity; beside a thousand steps that does not show.
        spent(lambda: compiled(*at))
    seconds = spent(lambda: compiled(*at))
    return {
        "nodes": mesh.n_nodes,
        "steps": n_steps,
        "way": way,
        "cpu": seconds,
        # What XLA keeps while it runs; the peak of the process includes the compiler.
        "buffers_mb": compiled.memory_analysis().temp_size_in_bytes / 2**20,
        "peak_mb": peak(),
        "compile": compile_seconds,
    }


def equilibrium_row(level: int) -> dict:
    """An equilibrium from a spheroid, the same solved again, and the gradient of that."""
    mesh, x = jw.equilibria.spheroid(0.8, "prolate", level=level)

    def search():
        return jw.equilibria.equilibrium(mesh, x, reduced_volume=0.8, stability=False)

    search()  # compiles
    began = time.process_time()
    shape = search()
    equilibrium_seconds = time.process_time() - began
    weights = jr.normal(jr.key(0), x.shape) / mesh.n_nodes

    @eqx.filter_jit
    def again(p, shape):
        found = jw.equilibria.resolve(shape, p)
        return found.energy + jnp.vdot(weights, found.x)

    slope = eqx.filter_jit(eqx.filter_value_and_grad(again))
    # Newly solved for other parameters: as a step of a fit does.
    p = eqx.tree_at(lambda p: p.volume, shape.parameters, 0.998 * shape.parameters.volume)
    again(p, shape), slope(p, shape)
    resolve_seconds = min(spent(lambda: again(p, shape)) for _ in range(3))
    gradient_seconds = min(spent(lambda: slope(p, shape)) for _ in range(3))
    return {
        "nodes": mesh.n_nodes,
        "equilibrium": equilibrium_seconds,
        "newton": shape.stats["newton_iterations"],
        "resolve": resolve_seconds,
        "gradient": gradient_seconds,
        "extra": (gradient_seconds - resolve_seconds) / equilibrium_seconds,
        "over_resolve": (gradient_seconds - resolve_seconds) / resolve_seconds,
        "peak_mb": peak(),
    }


def peak() -> float:
    """Largest memory of this process so far, megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def in_a_process(**row) -> dict:
    """The row computed by a process of its own; it is shown at once, the table comes last."""
    command = [sys.executable, __file__, "--row", json.dumps(row)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found = json.loads(done.stdout.splitlines()[-1])
    words = (f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in found.items())
    print(", ".join(words), file=sys.stderr, flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="1,000 steps and 2,562 nodes as well")
    parser.add_argument("--quick", action="store_true", help="162 nodes only")
    parser.add_argument("--row", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.row:
        row = json.loads(args.row)
        print(json.dumps(trajectory_row(**row) if "way" in row else equilibrium_row(**row)))
        return
    levels = (1,) if args.quick else (2, 3) if args.full else (1, 2)
    counts = (10, 100, 1000) if args.full else (10, 100)
    rows = []
    for level in levels:
        for n_steps in counts:
            # A thousand linearisations of 2,562 nodes do not fit into most memories.
            ways = WAYS if n_steps <= 100 else WAYS[:2]
            own = [in_a_process(level=level, n_steps=n_steps, way=way) for way in ways]
            for row in own:
                row["extra"] = (row["cpu"] - own[0]["cpu"]) / own[0]["cpu"]
            own[0]["extra"] = None
            rows += own
    columns = {
        "nodes": "nodes",
        "steps": "steps",
        "way": "what",
        "cpu": "CPU s",
        "extra": "beyond the run",
        "buffers_mb": "buffers MB",
        "peak_mb": "peak MB",
        "compile": "compilation s",
    }
    print("Trajectories")
    print(format_table(rows, columns))
    shapes = [in_a_process(level=level) for level in levels]
    columns = {
        "nodes": "nodes",
        "equilibrium": "equilibrium s",
        "newton": "Newton",
        "resolve": "resolve s",
        "gradient": "gradient s",
        "extra": "extra/equilibrium",
        "over_resolve": "extra/resolve",
        "peak_mb": "peak MB",
    }
    print("\nEquilibria, prolate v = 0.8")
    print(format_table(shapes, columns))
    plain = max(row["extra"] for row in rows if row["way"] == "gradient")
    print(
        f"A gradient costs at most {plain:.2f} times its run beyond the run (target 1.0), and at "
        f"most {max(row['extra'] for row in shapes):.3f} times an equilibrium (target 0.15)."
    )


if __name__ == "__main__":
    main()

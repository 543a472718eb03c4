"""How time and memory of a step grow with the mesh, 642 to 163,842 nodes of degree 2.

    python benchmarks/growth.py [--full]

A red cell relaxes. CPU seconds of an accepted step (the mean from the fourth on), what precedes
the first step, peak memory of the process and what `memory_estimate` says of it, each size in a
process of its own. `rate` is the exponent of the step time against the size before. Two flows:
Willmore flow with 8 fields, and with the tangential velocity of minimal deformation, 12 fields.
`--full` goes beyond 10,242 nodes (half an hour, 9 GB).
"""

import argparse
import json
import math
import resource
import subprocess
import sys
import time

import jaxwillmore as jw
from jaxwillmore.verify import format_table

LEVELS = {False: (2, 3, 4), True: (2, 3, 4, 5, 6)}
STEPS = {2: 20, 3: 20, 4: 20, 5: 12, 6: 8}
SKIPPED = 3
COLUMNS = {
    "nodes": "nodes",
    "to_first_step": "to first step, s",
    "step": "step, s",
    "rate": "rate",
    "newton": "Newton/step",
    "krylov": "Krylov/Newton",
    "jacobians": "Jacobians/step",
    "peak_gb": "peak, GB",
    "estimate_gb": "estimated, GB",
}


def measured(level: int, tangential: bool) -> dict:
    """One run in this process."""
    began = time.process_time()
    mesh, x = jw.mesh.red_cell(level=level, degree=2)
    flow = jw.flows.WillmoreFlow()
    if tangential:
        flow = jw.flows.System(flow, jw.flows.MinimalDeformation())
    marks = []
    solution = jw.evolve.evolve(
        flow,
        mesh,
        x,
        t1=5.0,
        max_steps=STEPS[level],
        throw=False,
        observer=lambda record, state: marks.append(time.process_time()),
    )
    steps, stats = len(marks) - SKIPPED, solution.stats
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "nodes": mesh.n_nodes,
        "to_first_step": marks[0] - began,
        "step": (marks[-1] - marks[SKIPPED - 1]) / steps,
        "newton": stats["newton_iterations"] / stats["steps"],
        "krylov": stats["linear_iterations"] / stats["newton_iterations"],
        "jacobians": stats["jacobians"] / stats["steps"],
        "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9,
        "estimate_gb": jw.evolve.memory_estimate(flow, mesh) / 1e9,
    }


def in_own_process(level: int, tangential: bool) -> dict:
    """The same in a new process, whose memory is its own."""
    command = [sys.executable, __file__, "--one", str(level), str(int(tangential))]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return json.loads(out.splitlines()[-1])


def main(full: bool):
    """A table for each flow."""
    for tangential, title in ((False, "Willmore flow"), (True, "with minimal deformation")):
        rows = []
        for level in LEVELS[full]:
            row = in_own_process(level, tangential)
            if rows:
                last = rows[-1]
                row["rate"] = math.log(row["step"] / last["step"]) / math.log(
                    row["nodes"] / last["nodes"]
                )
            rows.append(row)
        print(f"\n{title}")
        print(format_table(rows, COLUMNS), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="40,962 and 163,842 nodes too")
    parser.add_argument("--one", nargs=2, type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measured(arguments.one[0], bool(arguments.one[1]))))
    else:
        main(arguments.full)

"""Constrained flows and equilibria meet: the prolate vesicle, and vesicles from an irregular mesh.

    python benchmarks/constrained.py [--full]

1. An ellipsoid of reduced volume 0.8 flows, with area and volume held, to the prolate vesicle, by
   t = 20 for good (642 nodes; 162 without `--full`). `drift` is the largest relative change of area
   and volume over all accepted steps, `rise` that of the energy. The equilibrium solver, started
   from the end of the flow, improves the energy to its own accuracy.
2. Oblate vesicles from the mesh of another code (642 vertices without symmetry, raised to degree
   2): energies against the axisymmetric reference.
"""

import argparse
import math
import time

import jaxwillmore as jw
from jaxwillmore.cases import example_path
from jaxwillmore.verify import format_table

# E/(8 pi kappa), sigma R0^2/kappa, P R0^3/kappa of an axisymmetric spectral solver.
PROLATE = 1.387440432, -5.112, -12.78
OBLATE = {0.65: 1.826233446, 0.70: 1.699111050}


def constrained_flow(level: int) -> list[dict]:
    """The flow to t = 20 and the equilibrium from its end."""
    mesh, x = jw.equilibria.spheroid(0.8, "prolate", level=level, degree=2)
    A, V = float(jw.surface.area(mesh, x)), float(jw.surface.volume(mesh, x))
    flow = jw.flows.System(
        jw.flows.WillmoreFlow(), jw.flows.Loads(area=A, volume=V), jw.flows.MinimalDeformation()
    )
    began = time.process_time()
    solution = jw.evolve.evolve(flow, mesh, x, t1=20.0)
    seconds = time.process_time() - began
    records, R0 = solution.records, math.sqrt(A / (4 * math.pi))
    energies = [record["willmore"] for record in records]
    last = records[-1]
    flow_row = {
        "what": "flow to t = 20",
        "nodes": mesh.n_nodes,
        "energy": last["willmore"] / (8 * math.pi) / PROLATE[0] - 1,
        "sigma": last["tension"] * R0**2,
        "P": last["pressure"] * R0**3,
        "drift": max(max(abs(r["area"] / A - 1), abs(r["volume"] / V - 1)) for r in records),
        "rise": max(b / a - 1 for a, b in zip(energies, energies[1:], strict=False)),
        "max |V|": last["stationarity"],
        "steps": len(records),
        "rejected": solution.stats["rejected_steps"],
        "seconds": seconds,
    }
    began = time.process_time()
    shape = jw.equilibria.equilibrium(mesh, solution.state.x, area=A, volume=V)
    row = {
        "what": "equilibrium from there",
        "nodes": mesh.n_nodes,
        "energy": float(shape.bending_over_8pi_kappa) / PROLATE[0] - 1,
        "sigma": float(shape.scaled_tension),
        "P": float(shape.scaled_pressure),
        "seconds": time.process_time() - began,
    }
    return [flow_row, row]


def irregular(volumes) -> list[dict]:
    """Vesicles from the mesh of a simulated red cell, scaled to the area 4 pi."""
    mesh, x = jw.io.read_surface(example_path("example:mirheo_rbc.npz"), degree=2)
    rows = []
    for v in volumes:
        shape = jw.equilibria.equilibrium(mesh, x, area=4 * math.pi, reduced_volume=v)
        rows.append(
            {
                "v": v,
                "nodes": mesh.n_nodes,
                "energy": f"{float(shape.bending_over_8pi_kappa):.8f}",
                "reference": f"{OBLATE[v]:.8f}",
                "error": float(shape.bending_over_8pi_kappa) - OBLATE[v],
                "sigma": float(shape.scaled_tension),
                "P": float(shape.scaled_pressure),
                "negative": shape.negative_directions,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="642 nodes, two irregular vesicles")
    full = parser.parse_args().full
    rows = constrained_flow(2 if full else 1)
    print("Prolate vesicle, v = 0.8; energy: relative error")
    print(format_table(rows, list(rows[0])), flush=True)
    rows = irregular((0.65, 0.70) if full else (0.65,))
    print("\nOblate vesicles from an irregular mesh of degree 2; E/(8 pi kappa)")
    print(format_table(rows, list(rows[0])))


if __name__ == "__main__":
    main()

"""Do stationary surfaces stay still, and do the equations have the growth rate they must have?

    python benchmarks/stability.py [--full]

1. The unit sphere with nu = (1 + e) times its normal: without consistency terms e grows at exactly
   +8, which checks the signs of all four equations; with c = 2.5 (alpha = 10 on the unit sphere) it
   decays.
2. The Clifford torus is stationary with energy 4 pi^2. `distance` is the L2 norm of the distance
   from the exact torus divided by the root of the area: its root mean square.
"""

import argparse
import math

import jax.numpy as jnp

import jaxwillmore as jw
from jaxwillmore.verify import format_table, normal_growth_rate, surface_errors

CLIFFORD = 4 * math.pi**2
# (n_major, n_minor): largest distance and energy error at T = 0.2; twice that at T = 1.
LIMITS = {(10, 9): (2.5e-3, 7e-4), (16, 13): (5e-4, 2e-4)}


def growth(full: bool) -> list[dict]:
    """Growth rates of the length of the normal on the unit sphere."""
    cases = [(2, 1), (2, 2), (3, 1), (4, 1)] + ([(3, 2), (2, 3)] if full else [])
    rows = []
    for degree, level in cases:
        mesh, x = jw.mesh.icosphere(level, degree)
        rates = [normal_growth_rate(mesh, x, c) for c in (0.0, 2.5)]
        rows.append(
            {
                "degree": degree,
                "nodes": mesh.n_nodes,
                "alpha0": f"{rates[0]:+.3f}",
                "alpha10": f"{rates[1]:+.3f}",
                "ok": abs(rates[0] - 8) <= 0.1 and rates[1] <= 0.05,
            }
        )
    return rows


def clifford(counts: tuple[int, int]) -> list[dict]:
    """Distance from the Clifford torus and energy error at two times."""
    radii = 1.0, math.sqrt(0.5)
    mesh, x = jw.mesh.torus(*radii, n_major=counts[0], n_minor=counts[1], degree=2)
    exact = jw.surface.Torus(*radii)
    solution = jw.evolve.evolve(
        jw.flows.WillmoreFlow(),
        mesh,
        x,
        t1=1.0,
        initial={"H": exact.mean_curvature(x), "nu": exact.normal(x)},
        saveat=[0.2, 1.0],
    )
    rows = []
    for state in solution.saved[1:]:
        distance = surface_errors(mesh, state.x, state.nu, state.H, exact)["x_l2"]
        distance = float(distance / jnp.sqrt(jw.surface.area(mesh, state.x)))
        energy = float(jw.energies.Willmore()(mesh, state.x)) / CLIFFORD - 1
        factor = 1 if state.t < 0.5 else 2
        limit, energy_limit = (factor * value for value in LIMITS[counts])
        rows.append(
            {
                "nodes": mesh.n_nodes,
                "T": state.t,
                "distance": distance,
                "allowed": limit,
                "energy": energy,
                "energy_allowed": energy_limit,
                "steps": solution.stats["steps"],
                "rejected": solution.stats["rejected_steps"],
                "ok": distance <= limit and abs(energy) <= energy_limit,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="finer meshes as well")
    full = parser.parse_args().full
    rows = growth(full)
    columns = {"alpha0": "alpha = 0", "alpha10": "alpha = 10"}
    print(format_table(rows, {"degree": "degree", "nodes": "nodes", **columns, "ok": "ok"}))
    best = min(rows, key=lambda row: abs(float(row["alpha0"]) - 8))
    print(
        f"Growth of |nu| on the unit sphere: {best['alpha0']} at degree {best['degree']} with "
        f"{best['nodes']} nodes (exact: +8); with alpha = 10 it decays.\n"
    )
    rows = [row for counts in LIMITS for row in clifford(counts)]
    print(format_table(rows, list(rows[0])))
    print(
        "Clifford torus: within the allowed distance and energy error of the exact torus."
        if all(row["ok"] for row in rows)
        else "Clifford torus: NOT within the allowed distance or energy error."
    )


if __name__ == "__main__":
    main()

"""Loaded and second-order flows against exact laws: radii, rates of modes, conserved quantities.

    python benchmarks/loaded.py [--full]

1. Spheres follow their ordinary differential equation: orders in time of BDF1 and BDF2 against very
   short steps on the same mesh, and the distance from the exact sphere in the end (degree 2).
2. Small modes of a sphere at rest change at the exact rate.
3. Prescribed area and volume hold at every accepted step.

`--full` takes more energies, the mesh of 642 nodes for the rates, and mode 3.
"""

import argparse

import numpy as np

import jaxwillmore as jw
from jaxwillmore.energies import OsmoticPressure, Pressure, SurfaceTension
from jaxwillmore.flows import Loads, MinimalDeformation, SurfaceDiffusion, System, WillmoreFlow
from jaxwillmore.verify import (
    TimeStudy,
    balanced_flow,
    format_table,
    loaded_sphere_problem,
    mode_errors,
    mode_rate,
    speed_problem,
)

STEPS = (20, 40, 80)


def inverse(H):
    """F of inverse mean curvature flow."""
    return -1.0 / H


def square(H):
    """F of the flow by the square of the mean curvature."""
    return H**2


def problems(full: bool) -> list:
    """Spheres whose radius moves by 2 to 40 %."""
    osmotic = OsmoticPressure(5.0, 1.0, temperature=1.0, gas_constant=0.5)
    tension, pressure = SurfaceTension(0.3), Pressure(0.8)
    few = [
        loaded_sphere_problem(tension + pressure, 0.5, 0.5, 0.5, "H0, tension, pressure"),
        loaded_sphere_problem(osmotic, 0.3, 0.5, 0.0, "osmotic pressure"),
        speed_problem(None, 0.1, "mean curvature"),
        speed_problem(inverse, 0.4, "inverse mean curvature"),
        speed_problem(square, 0.04, "square of H"),
    ]
    more = [
        loaded_sphere_problem(tension, 0.5, 0.5, 1.0, "H0, tension"),
        loaded_sphere_problem(osmotic + tension, 0.05, 0.5, -0.5, "H0 < 0, tension, osmotic"),
    ]
    return few + more if full else few


def radius_orders(problem, level: int) -> dict:
    """Orders in time and true error of one problem, as a row."""
    study = TimeStudy(problem, degree=2, level=level, n_reference=160)
    one, two = (study.orders(q, STEPS) for q in (1, 2))
    orders = [rows[-1]["x_l2_order"] for rows in (one, two)]
    exact = problem.surface(problem.t1)
    area = float(jw.surface.area(study.mesh, study.reference.x))
    return {
        "law": problem.name,
        "nodes": study.mesh.n_nodes,
        "radius": f"{float(exact.radius):.6f}",
        "error": np.sqrt(area / (4 * np.pi)) / float(exact.radius) - 1,
        "bdf1": one[-1]["x_l2"],
        "order1": orders[0],
        "bdf2": two[-1]["x_l2"],
        "order2": orders[1],
        "ok": abs(orders[0] - 1) < 0.15 and abs(orders[1] - 2) < 0.25,
    }


def mode_rows(level: int, modes) -> list[dict]:
    """Rates of modes under flows that leave the unit sphere at rest."""
    rows = []
    for mode in modes:
        cases = [
            ("H0 = 1, tension 1", balanced_flow(1.0, 1.0), mode_rate(mode, 1.0, 0.5, 1.0, 1.0)),
            ("H0 = -1, tension 2", balanced_flow(-1.0, 2.0), mode_rate(mode, 1.0, 0.5, -1.0, 2.0)),
            # On the unit sphere the same numbers as for Willmore flow.
            ("surface diffusion", SurfaceDiffusion(), mode_rate(mode)),
        ]
        for name, flow, rate in cases:
            row = mode_errors(mode, 2, level, flow=flow, exact_rate=rate)
            error = row["rate"] / rate - 1
            rows.append(
                {
                    "flow": name,
                    "mode": mode,
                    "nodes": row["nodes"],
                    "exact": f"{rate:.2f}",
                    "rate": f"{row['rate']:.4f}",
                    "error": error,
                    "ok": abs(error) <= 0.01,
                }
            )
    return rows


def conservation() -> list[dict]:
    """Largest defects of prescribed area and volume over all accepted steps."""
    mesh, x = jw.mesh.ellipsoid(semi_axes=(1.0, 1.0, 1.4), level=1, degree=2)
    A, V = float(jw.surface.area(mesh, x)), float(jw.surface.volume(mesh, x))

    def inflated(t):
        return V * (1 + t)

    def deflated(t):
        return V * (1 - 2 * t)

    willmore = WillmoreFlow()
    both = Loads(area=A, volume=deflated)
    cases = [
        ("volume inflated", System(willmore, Loads(volume=inflated)), inflated, False),
        (
            "area held, volume deflated",
            System(willmore, both, MinimalDeformation()),
            deflated,
            True,
        ),
    ]
    rows = []
    for name, flow, target, with_area in cases:
        run = jw.evolve.evolve(flow, mesh, x, t1=0.05, dt0=1e-4)
        volume = max(abs(r["volume"] / target(r["t"]) - 1) for r in run.records)
        area = max(abs(r["area"] / A - 1) for r in run.records) if with_area else None
        rows.append(
            {
                "run": name,
                "steps": len(run.records),
                "rejected": run.stats["rejected_steps"],
                "volume change": f"{run.records[-1]['volume'] / V - 1:+.3f}",
                "volume defect": volume,
                "area defect": area,
                "ok": max(volume, area or 0.0) <= 1e-10,
            }
        )
    return rows


def diffusion_volume() -> list[dict]:
    """Surface diffusion keeps the volume, up to the error of the steps, while the area falls."""
    mesh, x = jw.mesh.ellipsoid(semi_axes=(1.0, 1.0, 1.4), level=1, degree=2)
    V = float(jw.surface.volume(mesh, x))
    rows = []
    for rtol in (1e-3, 1e-4):
        run = jw.evolve.evolve(SurfaceDiffusion(), mesh, x, t1=0.2, rtol=rtol)
        areas = [record["area"] for record in run.records]
        drift = max(abs(record["volume"] / V - 1) for record in run.records)
        rows.append(
            {
                "nodes": mesh.n_nodes,
                "rtol": rtol,
                "steps": len(areas),
                "volume drift": drift,
                "area rise": max(0.0, *np.diff(areas)) / areas[0],
                "reduced volume": f"{run.records[-1]['reduced_volume']:.5f}",
                "ok": drift <= rtol and bool(np.max(np.diff(areas)) <= 1e-6 * areas[0]),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="more cases, finer meshes")
    full = parser.parse_args().full
    everything = []

    def show(title: str, rows: list[dict]) -> None:
        everything.extend(rows)
        print(title, format_table(rows, list(rows[0])), sep="\n", end="\n\n", flush=True)

    show("Prescribed area and volume:", conservation())
    show("Radii of spheres:", [radius_orders(p, 1) for p in problems(full)])
    show("Surface diffusion of an ellipsoid:", diffusion_volume())
    show("Rates of modes:", mode_rows(2 if full else 1, (2, 3) if full else (2,)))
    missed = sum(not row["ok"] for row in everything)
    print("All within their targets." if not missed else f"{missed} rows miss their target.")


if __name__ == "__main__":
    main()

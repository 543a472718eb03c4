"""Vesicles of two phases against axisymmetric solutions, the energy law, and what a step costs.

    python benchmarks/two_phase_vesicles.py [--full]

1. Vesicles of reduced volume 0.85 with one interface, half of the area in each phase, line tension
   4 in units of kappa and R0 = sqrt(A/4 pi), from a spheroid with a stripe until they are at rest.
   A: equal phases; B: b = 2 and b_k = -1 in phase 0, b = 1 and 0 in phase 1; C: H0 = 1.5 in phase
   1. 642 nodes of degree 2; with `--full` 2,562 too. `rise` is the largest relative rise of the
   energy in a step; area, volume and amount are largest relative changes over the run.
2. dE/dt against the dissipation -int V^2 - int M |grad mu|^2, the trapezoidal rule over each step,
   for fixed steps: over the whole decay, and the largest mismatch of a step of its later part,
   which stops at the error of the mesh.
3. CPU seconds of a step of the coupled system over those of one phase, same mesh, same run.
"""

import argparse
import time

import jax.numpy as jnp
import numpy as np

import jaxwillmore as jw
from jaxwillmore.energies import CanhamHelfrich, Mixture, TwoPhase
from jaxwillmore.flows import CahnHilliard, gradient_flow
from jaxwillmore.phases import stripe
from jaxwillmore.verify import format_table

# Energy of the axisymmetric solution by case and width.
REFERENCE = {
    ("A", 0.3): 48.84456178,
    ("A", 0.15): 48.60867997,
    ("B", 0.15): 58.27815076,
    ("C", 0.15): 34.52948050,
    ("C", 0.3): 34.45982635,
}
MODULI = {
    "A": {},
    "B": {"bending_modulus": Mixture(1.0, 0.5), "gaussian_modulus": Mixture(-1.0, 0.0)},
    "C": {"spontaneous_curvature": Mixture(0.0, 1.5)},
}


def start(level: int):
    """A spheroid of area 4 pi and reduced volume 0.85."""
    mesh, x = jw.mesh.ellipsoid((0.7119562, 0.7119562, 1.6769200), level, degree=2)
    return mesh, x * jnp.sqrt(4 * jnp.pi / jw.surface.area(mesh, x))


def flow_of(case: str, width: float, mesh, x):
    """The gradient flow with area, volume and amount held."""
    return gradient_flow(
        TwoPhase(**MODULI[case], line_tension=4.0, interface_width=width),
        phase=CahnHilliard(),
        area=jw.surface.area(mesh, x),
        volume=jw.surface.volume(mesh, x),
        tangential="minimal-deformation",
    )


def vesicle(case: str, width: float, level: int) -> dict:
    """One vesicle to rest."""
    mesh, x = start(level)
    c = stripe(mesh, x, width, 0.5)
    flow = flow_of(case, width, mesh, x)
    began = time.process_time()
    run = jw.evolve.evolve(
        flow, mesh, x, t1=200.0, rtol=2e-3, stationary_tolerance=1e-5, initial={"c": c},
        throw=False,
    )  # fmt: skip
    seconds = time.process_time() - began
    records, first = run.records, float(jw.phases.amount(mesh, x, c))
    energies = [record["energy"] for record in records]
    A, V = (float(of(mesh, x)) for of in (jw.surface.area, jw.surface.volume))
    return {
        "case": case,
        "width": width,
        "nodes": mesh.n_nodes,
        "E": f"{energies[-1]:.6f}",
        "error": energies[-1] / REFERENCE[case, width] - 1,
        "sigma": records[-1]["tension"],
        "P": records[-1]["pressure"],
        "area": max(abs(r["area"] / A - 1) for r in records),
        "volume": max(abs(r["volume"] / V - 1) for r in records),
        "amount": max(abs(r["phase_amount"] / first - 1) for r in records),
        "rise": max(b / a - 1 for a, b in zip(energies, energies[1:], strict=False)),
        "steps": len(records),
        "rejected": run.stats["rejected_steps"],
        "rest": jw.evolve.name_of(run.result),
        "activity": records[-1]["stationarity"],
        "seconds": seconds,
    }


def energy_law(level: int) -> list[dict]:
    """Mismatch of dE/dt over fixed steps, from the state at t = 0.002."""
    mesh, x = start(level)
    flow = flow_of("A", 0.3, mesh, x)
    t0, t1, rows = 2e-3, 2e-2, []
    first = jw.evolve.evolve(
        flow, mesh, x, t1=t0, rtol=1e-4, initial={"c": stripe(mesh, x, 0.3, 0.5)}
    ).state
    for n in (10, 20, 40, 80):
        times, energies, rates = [], [], []

        def seen(record, state, times=times, energies=energies, rates=rates):
            V = state.V
            square = jw.fem.integrate(mesh, state.x, lambda _, f: f.V.value**2, {"V": V})
            times.append(record["t"])
            energies.append(record["energy"])
            rates.append(-float(square) - record["phase_dissipation"])

        jw.evolve.evolve(
            flow, mesh, first.x, t0=t0, t1=t1, dt0=(t1 - t0) / n, rtol=None, observer=seen,
            initial={name: first.fields[name] for name in flow.evolving},
        )  # fmt: skip
        t, E, rate = (np.array(a) for a in (times, energies, rates))
        found, mean = np.diff(E) / np.diff(t), 0.5 * (rate[1:] + rate[:-1])
        late = t[:-1] > 2 * t0
        row = {"nodes": mesh.n_nodes, "step": (t1 - t0) / n, "steps": len(t)}
        row["whole decay"] = abs(float((E[-1] - E[0]) / np.trapezoid(rate, t) - 1))
        row["largest, late"] = float(np.max(np.abs(found / mean - 1)[late]))
        for name in ("whole decay", "largest, late"):
            row[f"order, {name}"] = float(np.log2(rows[-1][name] / row[name])) if rows else None
        rows.append(row)
    return rows


def cost(level: int) -> dict:
    """CPU seconds of twelve steps after the first two."""
    mesh, x = start(level)
    c = stripe(mesh, x, 0.3, 0.5)
    held = {"area": jw.surface.area(mesh, x), "volume": jw.surface.volume(mesh, x)}
    one = gradient_flow(CanhamHelfrich(0.5), tangential="minimal-deformation", **held)

    def seconds(flow, initial):
        marks = []
        jw.evolve.evolve(
            flow, mesh, x, t1=10.0, dt0=1e-5, rtol=2e-3, max_steps=14, throw=False,
            initial=initial, observer=lambda *_: marks.append(time.process_time()),
        )  # fmt: skip
        return (marks[-1] - marks[1]) / (len(marks) - 2)

    alone = seconds(one, None)
    rows = {name: seconds(flow_of(name, 0.3, mesh, x), {"c": c}) for name in ("A", "B")}
    return {
        "nodes": mesh.n_nodes,
        "one phase, s": alone,
        "equal phases, s": rows["A"],
        "unequal phases, s": rows["B"],
        "ratio, equal": rows["A"] / alone,
        "ratio, unequal": rows["B"] / alone,
    }


def show(title: str, rows: list[dict]) -> None:
    """One table."""
    print(f"\n{title}")
    print(format_table(rows, list(rows[0])), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="2,562 nodes beside 642")
    levels = (2, 3) if parser.parse_args().full else (2,)
    rows = [vesicle(*key, level) for level in levels for key in REFERENCE]
    show("Vesicles of two phases", rows)
    rows = [row for level in levels for row in energy_law(level)]
    show("dE/dt against the dissipation", rows)
    show("A step, CPU seconds", [cost(level) for level in levels])


if __name__ == "__main__":
    main()

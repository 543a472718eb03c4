"""Triangles while a surface relaxes: with and without tangential motion, and in other schemes.

    python benchmarks/mesh_quality.py [--shapes dumbbell red_cell beads_torus] [--out quality.png]

Willmore flow from exact initial fields, degree 2, adaptive steps; the schemes of Dziuk and of
Barrett, Garcke and Nürnberg with as many nodes on flat triangles and fixed steps. Angles, the ratio
of the longest to the shortest edge and that of the largest to the smallest triangle are those of
the flat triangles between the vertices. `drift` is the change of area after 16 % of the time, when
the surface has nearly arrived; energies come from the nodes alone.
"""

import argparse
import dataclasses
import math

import numpy as np

import jaxwillmore as jw
from jaxwillmore.verify import format_table

SPHERE, CLIFFORD = 8 * math.pi, 4 * math.pi**2
MAX_STEPS = 150
MEASURES = {
    "min_angle": "smallest angle [degrees]",
    "edge_ratio": "longest / shortest edge",
    "area_ratio": "largest / smallest triangle",
}


@dataclasses.dataclass(frozen=True)
class Case:
    """A shape, where it goes, and what is allowed."""

    options: dict
    t1: float
    target: float
    allowed: float
    # Fixed step of the schemes; None leaves them out.
    tau: float | None


CASES = {
    "dumbbell": Case({"level": 1}, 0.5, SPHERE, 1e-3, 2.5e-4),
    "red_cell": Case({"level": 1}, 5.0, SPHERE, 1e-4, 5e-3),
    # The tube opens from radius 0.4 to 0.7: fewer points around it would leave needles at the end.
    "beads_torus": Case({"n_major": 24, "n_minor": 12}, 2.0, CLIFFORD, 1e-2, None),
}


@dataclasses.dataclass
class History:
    """Quality, energy and area against time."""

    name: str
    nodes: int
    t: list
    quality: list
    energy: list
    area: list
    steps: int
    newton: float | None = None
    result: str = ""


def of_flow(name: str, flow, shape: str, case: Case) -> History:
    """An adaptive run."""
    mesh, x, exact = jw.shapes.make_shape(shape, degree=2, **case.options)
    times, qualities = [0.0], [jw.mesh.quality(mesh, x)]

    def observer(record, state):
        times.append(record["t"])
        qualities.append(jw.mesh.quality(mesh, state.x))

    run = jw.evolve.evolve(
        flow,
        mesh,
        x,
        t1=case.t1,
        initial={"H": exact.mean_curvature(x), "nu": exact.normal(x)},
        observer=observer,
        # Where triangles degenerate a run may creep on in ever smaller steps.
        max_steps=MAX_STEPS,
        throw=False,
    )
    first = {"willmore": float(jw.energies.Willmore()(mesh, x)), "area": _area(mesh, x)}
    records = [first, *run.records]
    return History(
        name,
        mesh.n_nodes,
        times,
        qualities,
        [r["willmore"] for r in records],
        [r["area"] for r in records],
        run.stats["steps"],
        run.stats["newton_iterations"] / max(run.stats["steps"], 1),
        jw.evolve.name_of(run.result),
    )


def of_scheme(scheme, shape: str, case: Case) -> History:
    """Fixed steps on flat triangles, with as many nodes as the flows have."""
    options = case.options | {"level": case.options["level"] + 1}
    mesh, x, _ = jw.shapes.make_shape(shape, degree=1, **options)
    n = round(case.t1 / case.tau)
    run = jw.schemes.march(scheme, mesh, x, tau=case.tau, n_steps=n, throw=False)
    seen = [k for k in range(n + 1) if k < 20 or k % 10 == 0 or k == n]
    seen = [k for k in seen if bool(np.all(np.isfinite(run.x[k])))]
    energy = jw.energies.Willmore()
    return History(
        type(scheme).__name__,
        mesh.n_nodes,
        [float(run.times[k]) for k in seen],
        [jw.mesh.quality(mesh, run.x[k]) for k in seen],
        [float(energy(mesh, run.x[k])) for k in seen],
        [_area(mesh, run.x[k]) for k in seen],
        n,
        None,
        "reached_t1" if seen[-1] == n else "broke down",
    )


def _area(mesh, x) -> float:
    return float(jw.surface.area(mesh, x))


def histories(shape: str) -> list[History]:
    """All methods on one shape."""
    case, plain = CASES[shape], jw.flows.WillmoreFlow()
    even = jw.flows.System(plain, jw.flows.MinimalDeformation())
    runs = [
        of_flow("normal velocity", plain, shape, case),
        of_flow("tangential velocity", even, shape, case),
    ]
    if case.tau is not None:
        schemes = jw.schemes.DziukWillmore(), jw.schemes.BGNWillmore()
        runs += [of_scheme(scheme, shape, case) for scheme in schemes]
    return runs


def row(shape: str, h: History) -> dict:
    """What matters of a history."""
    case, last = CASES[shape], h.quality[-1]
    late = [a for t, a in zip(h.t, h.area, strict=True) if t >= 0.16 * case.t1]
    return {
        "shape": shape,
        "method": h.name,
        "nodes": h.nodes,
        "steps": h.steps,
        "newton/step": h.newton,
        "start angle": h.quality[0].min_angle,
        "least angle": min(q.min_angle for q in h.quality),
        "end angle": last.min_angle,
        "edge ratio": last.edge_ratio,
        "area ratio": last.area_ratio,
        "energy": h.energy[-1] / case.target - 1,
        "drift": max(late) / min(late) - 1 if late else None,
        "result": h.result,
    }


def verdicts(rows: list[dict]) -> list[str]:
    """The targets, shape by shape, with what was reached."""
    lines = []
    for shape in dict.fromkeys(r["shape"] for r in rows):
        case = CASES[shape]
        plain, even = (
            next(r for r in rows if r["shape"] == shape and r["method"] == m)
            for m in ("normal velocity", "tangential velocity")
        )
        newton = even["newton/step"] / plain["newton/step"] - 1
        checks = [
            (
                f"energy {even['energy']:+.1e}, allowed {case.allowed:.0e}",
                abs(even["energy"]) <= case.allowed,
            )
        ]
        if case.target == SPHERE:
            text = f"Newton iterations per step {newton:+.0%}, allowed 20 %"
            checks.append((text, abs(newton) <= 0.2))
            ratio, drift = even["edge ratio"], even["drift"]
            checks.append((f"edge ratio {ratio:.3f}, allowed 1.4", ratio <= 1.4))
            checks.append((f"area drift {drift:.1e}, allowed 1e-3", drift <= 1e-3))
        lines.append(
            f"{shape}: " + "; ".join(text + ("" if ok else " (MISSED)") for text, ok in checks)
        )
    return lines


def picture(runs: dict[str, list[History]], path: str) -> None:
    """One row of curves per shape, one column per measure."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(
        len(runs), len(MEASURES), figsize=(13, 3.4 * len(runs)), squeeze=False, layout="constrained"
    )
    for line, (shape, listed) in zip(axes, runs.items(), strict=True):
        for ax, (measure, label) in zip(line, MEASURES.items(), strict=True):
            for h in listed:
                values = [getattr(q, measure) for q in h.quality]
                ax.plot(h.t[1:], values[1:], label=h.name, lw=1.6)
            ax.set_xscale("log")
            # The first steps are far shorter than anything that happens.
            ax.set_xlim(1e-5 * CASES[shape].t1, CASES[shape].t1)
            ax.set_ylim((0, 60) if measure == "min_angle" else (1, None))
            ax.set_xlabel("t")
            ax.set_ylabel(label)
            ax.set_title(shape.replace("_", " "))
            ax.grid(alpha=0.3, which="both", lw=0.5)
        line[0].legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description="Triangles while a surface relaxes.")
    parser.add_argument("--shapes", nargs="+", choices=sorted(CASES), default=list(CASES))
    parser.add_argument("--out", default="mesh_quality.png", help="where the picture goes")
    options = parser.parse_args()
    runs = {shape: histories(shape) for shape in options.shapes}
    rows = [row(shape, h) for shape, listed in runs.items() for h in listed]
    print(format_table(rows, list(rows[0])), *verdicts(rows), sep="\n")
    picture(runs, options.out)
    print(f"Curves in {options.out}.")


if __name__ == "__main__":
    main()

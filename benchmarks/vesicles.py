"""Vesicles: energies and multipliers of both branches against an axisymmetric spectral solver.

    python benchmarks/vesicles.py            162 and 642 nodes, minutes
    python benchmarks/vesicles.py --full     also 2,562 and 10,242 nodes
    python benchmarks/vesicles.py --crossing the crossing of the two branches near v = 0.651
    python benchmarks/vesicles.py --degrees  degrees 2, 3, 4 with about as many nodes, minutes

Errors are E/(8πκ) minus the reference; multipliers are σR0²/κ and P R0³/κ. Each mesh after the
first starts from the shape on the one before; `Newton` and `seconds` are those of the last mesh.
"""

import argparse
import time

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from jaxwillmore import equilibria

# kind, reduced volume, c0 R0 -> E/(8πκ), σR0²/κ, P R0³/κ
REFERENCE = {
    ("prolate", 0.90, 0.0): (1.189644033, None, None),
    ("prolate", 0.80, 0.0): (1.387440432, -5.112, -12.78),
    ("prolate", 0.70, 0.0): (1.643270425, None, None),
    ("prolate", 0.65, 0.0): (1.827929873, None, None),
    ("oblate", 0.90, 0.0): (1.217860261, None, None),
    ("oblate", 0.80, 0.0): (1.452538629, None, None),
    ("oblate", 0.70, 0.0): (1.699111050, None, None),
    ("oblate", 0.65, 0.0): (1.826233446, -5.004, -15.396),
    ("prolate", 0.80, 1.2): (0.39531312, None, None),
    ("oblate", 0.80, 1.2): (0.57115781, None, None),
}
# By the same solver, for the comparison of degrees.
OF_DEGREES = {("prolate", 0.85): 1.2856759621, ("oblate", 0.66): 1.8006179578}
DEGREES = ((2, 1), (2, 2), (2, 3), (3, 1), (3, 2), (4, 1), (4, 2))  # degree and level
HEADER = (
    f"{'shape':>8} {'v':>5} {'c0R0':>4} {'nodes':>6} {'E/(8πκ)':>12} {'error':>9} {'order':>5} "
    f"{'σR0²/κ':>9} {'PR0³/κ':>9} {'2σA/3PV-1':>9} {'neg':>3} {'Newton':>6} {'seconds':>7}"
)


def table(levels, cases):
    print(HEADER)
    for kind, v, H0 in cases:
        before = shape = None
        for level in levels:
            started = time.perf_counter()
            if shape is None:
                mesh, x = equilibria.spheroid(v, kind, level=level)
                shape = equilibria.equilibrium(
                    mesh,
                    x,
                    area=4 * np.pi,  # the unit of lengths on all meshes
                    reduced_volume=v,
                    spontaneous_curvature=H0,
                    throw=False,
                )
            else:
                shape = equilibria.refined(shape, throw=False)
            seconds = time.perf_counter() - started
            nodes = shape.mesh.n_nodes
            if not shape.succeeded:
                name = equilibria.name_of(shape.result)
                print(f"{kind:>8} {v:5.2f} {H0:4.1f} {nodes:6d} {name}")
                break
            before = _line(kind, v, H0, nodes, shape, seconds, before)


def _line(kind, v, H0, nodes, shape, seconds, before):
    energy = float(shape.bending_over_8pi_kappa)
    error = energy - REFERENCE[kind, v, H0][0]
    order = "" if before is None else f"{np.log2(abs(before / error)):5.2f}"
    p = shape.parameters
    identity = float(2 * p.tension * p.area / (3 * p.pressure * p.volume) - 1)
    print(
        f"{kind:>8} {v:5.2f} {H0:4.1f} {nodes:6d} {energy:12.8f} {error:9.1e} {order:>5} "
        f"{float(shape.scaled_tension):9.5f} {float(shape.scaled_pressure):9.5f} "
        f"{identity if H0 == 0 else float('nan'):9.1e} {shape.negative_directions:3d} "
        f"{shape.stats['newton_iterations']:6d} {seconds:7.1f}",
        flush=True,
    )
    return error


def crossing(level):
    """Where the prolate and the oblate branch have the same energy."""
    curves = {}
    for kind in ("prolate", "oblate"):
        mesh, x = equilibria.spheroid(0.67, kind, level=level)
        start = equilibria.equilibrium(mesh, x, reduced_volume=0.67, stability=False)
        found = equilibria.branch(start, stop=0.635, step0=0.006, max_step=0.007, stability=False)
        print(f"{kind}: {len(found.points)} points, {equilibria.name_of(found.result)}")
        rows = found.rows[::-1]
        v = [row["reduced_volume"] for row in rows]
        e = [row["bending_over_8pi_kappa"] for row in rows]
        curves[kind] = CubicSpline(v, e)
    where = brentq(lambda v: curves["prolate"](v) - curves["oblate"](v), 0.64, 0.665)
    print(f"crossing at v = {where:.5f} with {mesh.n_nodes} nodes (literature: near 0.651)")


def degrees():
    """Errors of E/(8πκ) and CPU seconds of a second call, from a spheroid."""
    print(f"{'shape':>8} {'v':>5} {'degree':>6} {'nodes':>6} {'error':>9} {'CPU seconds':>11}")
    for (kind, v), reference in OF_DEGREES.items():
        for degree, level in DEGREES:
            mesh, x = equilibria.spheroid(v, kind, level=level, degree=degree)
            for _ in range(2):  # the first compiles
                began = time.process_time()
                shape = equilibria.equilibrium(
                    mesh, x, reduced_volume=v, stability=False, throw=False
                )
                seconds = time.process_time() - began
            name = f"{float(shape.bending_over_8pi_kappa) - reference:9.1e}"
            if not shape.succeeded:
                name = equilibria.name_of(shape.result)
            nodes = mesh.n_nodes
            print(
                f"{kind:>8} {v:5.2f} {degree:6d} {nodes:6d} {name:>9} {seconds:11.1f}", flush=True
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="also 2,562 and 10,242 nodes")
    parser.add_argument("--levels", type=int, nargs="+", help="refinement levels instead")
    parser.add_argument("--crossing", action="store_true", help="only the crossing")
    parser.add_argument("--degrees", action="store_true", help="only degrees 2, 3 and 4")
    options = parser.parse_args()
    if options.degrees:
        degrees()
        return
    levels = sorted(options.levels or ([1, 2, 3, 4] if options.full else [1, 2]))
    if levels != list(range(levels[0], levels[-1] + 1)):
        parser.error("--levels must be consecutive: each starts from the one before")
    if options.crossing:
        crossing(levels[-1])
    else:
        table(levels, REFERENCE)


if __name__ == "__main__":
    main()

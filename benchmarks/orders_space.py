"""Orders in h of position, normal and mean curvature, in L2 and H1, on meshes without symmetry.

    python benchmarks/orders_space.py [--full]

Exact solutions: a sphere with spontaneous curvature on its ordinary differential equation, an
ellipsoid with prescribed moving axes (manufactured), and the modes l = 2 and 3 of the sphere, which
decay at the rates 24 and 120. Errors of x are distances between the surfaces (L2) and angles
between their normals (H1): where a node sits on the surface does not count. Steps of BDF4 are short
enough not to matter. `--full` adds one finer mesh.
"""

import argparse

from jaxwillmore.verify import (
    ERRORS,
    ellipsoid_problem,
    format_table,
    mode_errors,
    orders_in_space,
    sphere_problem,
    with_orders,
)

# Degree and the levels of refinement of its meshes; comparable numbers of nodes.
LEVELS = {1: (1, 2, 3), 2: (0, 1, 2), 3: (0, 1, 2)}
HEADINGS = {"degree": "degree", "nodes": "nodes", "h": "h"}
for _name in ERRORS:
    HEADINGS |= {_name: _name, f"{_name}_order": "order"}


def mode_study(mode: int, degree: int, levels) -> list[dict]:
    """The linearised decay of one mode on a sequence of meshes."""
    rows = with_orders([mode_errors(mode, degree, level) for level in levels], "h")
    for row in rows:
        row["rate_error"] = abs(row["rate"] / row["exact_rate"] - 1)
    return with_orders(rows, "h", (*ERRORS, "rate_error"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="one finer mesh each")
    parser.add_argument("--degrees", type=int, nargs="+", default=list(LEVELS), help="1, 2, 3")
    options = parser.parse_args()
    levels = {
        degree: found + ((found[-1] + 1,) if options.full else ())
        for degree, found in LEVELS.items()
        if degree in options.degrees
    }
    last = []
    for problem, steps in ((sphere_problem(), 24), (ellipsoid_problem(), 24)):
        print(f"\n{problem.name}, t = {problem.t1:g}")
        for degree, chosen in levels.items():
            rows = orders_in_space(problem, degree, chosen, n_steps=steps)
            print(format_table(rows, HEADINGS), flush=True)
            last.append({"problem": problem.name} | rows[-1])
    rates = {"rate_error": "rate", "rate_error_order": "order"}
    for mode in (2, 3):
        print(f"\nmode l = {mode}, until it has fallen by e; `rate`: relative error of the rate")
        for degree, chosen in levels.items():
            rows = mode_study(mode, degree, chosen)
            print(format_table(rows, HEADINGS | rates), flush=True)
            last.append({"problem": f"mode l = {mode}"} | rows[-1])
    quadratic = [row for row in last if row["degree"] == 2]
    if quadratic:
        worst = min(min(row["x_h1_order"], row["nu_h1_order"]) for row in quadratic)
        print(f"\nDegree 2: order in H1 of x and of the normal at least {worst:.2f} (target 1.9).")


if __name__ == "__main__":
    main()

"""Orders in the step size of BDF1 to BDF5, implicit and linearly implicit.

    python benchmarks/orders_time.py [--full]

Errors are distances to the solution of the same spatial discretisation with very short steps, in L2
and H1; `true_x_l2` is the distance from the exact surface, where the error of the mesh remains.
`--full` adds the linearly implicit scheme, the modes of the sphere, and longer sequences.
"""

import argparse

from jaxwillmore.verify import (
    ERRORS,
    TimeStudy,
    ellipsoid_problem,
    format_table,
    mode_problem,
    sphere_problem,
)

STEPS = {1: (20, 40, 80), 2: (20, 40, 80), 3: (20, 40, 80), 4: (20, 40, 80), 5: (20, 40, 80)}
HEADINGS = {"bdf_order": "BDF", "tau": "tau"}
for _name in ERRORS:
    HEADINGS |= {_name: _name, f"{_name}_order": "order"}
HEADINGS |= {"true_x_l2": "true x_l2"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="more problems, schemes and steps")
    full = parser.parse_args().full
    problems = [sphere_problem(), ellipsoid_problem()]
    problems += [mode_problem(2), mode_problem(3)] if full else []
    worst = {}
    for problem in problems:
        study = TimeStudy(problem, n_reference=640 if full else 320)
        for scheme in ("implicit", "linearly-implicit") if full else ("implicit",):
            print(f"\n{problem.name}, {scheme}, {study.mesh.n_nodes} nodes of degree 2")
            for order, steps in STEPS.items():
                rows = study.orders(
                    order, steps + ((2 * steps[-1],) if full else ()), scheme=scheme
                )
                print(format_table(rows, HEADINGS), flush=True)
                found = [rows[-1][f"{name}_order"] for name in ERRORS]
                if scheme == "implicit":
                    off = max(abs(value - order) for value in found)
                    worst[order] = max(worst.get(order, 0.0), off)
    print("\nLargest distance of an observed order of the implicit scheme from q, finest steps:")
    print(", ".join(f"BDF{order}: {off:.2f}" for order, off in worst.items()))
    print("Target: 0.3 for BDF1 to BDF4. BDF5 is offered with a warning and never the default.")


if __name__ == "__main__":
    main()

"""Derivatives of every output by every parameter: Taylor's slope, forward against reverse mode.

    python benchmarks/sensitivities.py [--full] [MAP ...]

Maps: the end of a run with tension, pressure and osmosis (`run-loaded`), with area and volume held
(`run-held`), with nodal fields (`run-fields`), of two phases (`run-phases`); an equilibrium with
area and volume held (`held`), under prescribed tension and pressure (`loaded`), with area held and
osmosis (`osmosis`), of two phases (`phases`); a point of a branch (`branch`). Targets: the order of
the remainder |f(p + h) - f(p) - h f'| is 2 ± 0.05, forward and reverse mode agree to 1e-10, and the
derivative of the energy of an equilibrium is what the envelope theorem says, to 1e-6. A dash stands
where the output is linear in the parameter up to rounding. 42 nodes of degree 2; with `--full` 162.
"""

import argparse
import math

import jax.numpy as jnp

import jaxwillmore as jw
from jaxwillmore.verify import (
    equilibrium_sensitivity,
    format_table,
    rough_sphere,
    run_sensitivity,
    sensitivity_rows,
    two_phase_run_sensitivity,
    two_phase_sensitivity,
)

RUNS = ("run-loaded", "run-held", "run-fields", "run-phases")
MAPS = (*RUNS, "held", "loaded", "osmosis", "branch", "phases")


def study(name: str, level: int):
    """The map, and the equilibrium it belongs to."""
    if name.startswith("run"):
        mesh, sphere = rough_sphere(level, 2)
        x = sphere * jnp.array([[1.0, 1.15, 1.35]])
        if name == "run-phases":
            return two_phase_run_sensitivity(mesh, x), None
        return run_sensitivity(mesh, x, 2, kind=name.removeprefix("run-")), None
    if name == "phases":
        mesh, x = jw.mesh.ellipsoid((0.712, 0.712, 1.677), level, degree=2)
        return two_phase_sensitivity(mesh, x), None
    mesh, x = jw.equilibria.spheroid(0.8, "prolate", level=level)
    shape = jw.equilibria.equilibrium(
        mesh, 3.0 * x, reduced_volume=0.8, bending_modulus=0.7, stability=False
    )
    if name == "branch":
        along = jw.equilibria.branch(shape, stop=0.76, step0=0.02, stability=False)
        shape = along.points[len(along.points) // 2]
    if name == "osmosis":
        shape = swollen(shape)
    return equilibrium_sensitivity(shape, held=name != "loaded"), shape


def swollen(shape):
    """The same shape with a free volume, held open by solute inside."""
    c_out = 5.0
    n = float(shape.parameters.volume) * (c_out + float(shape.pressure))
    osmosis = jw.energies.OsmoticPressure(n, c_out, 1.0, 1.0)
    energy = jw.energies.CanhamHelfrich(0.7) + osmosis
    return jw.equilibria.equilibrium(shape.mesh, shape.x, energy, stability=False)


def envelope(shape, rows) -> dict[str, float]:
    """Relative errors of the envelope theorem: dE*/dH0 = -int y·nu, dE*/dv = P dV/dv."""
    slope = {r["parameter"]: r["derivative"] for r in rows if r["output"] == "bending energy"}
    flux = jw.fem.integrate(
        shape.mesh,
        shape.x,
        lambda point, f: jnp.sum(f.Y.value * point.normal),
        {"Y": shape.Y},
        quadrature_degree=6,
    )
    by_volume = shape.pressure * shape.parameters.area**1.5 / (6 * math.sqrt(math.pi))
    return {
        "dE/dH0": abs(slope["H0"] / float(-flux) - 1),
        "dE/dv": abs(slope["reduced_volume"] / float(by_volume) - 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="162 nodes instead of 42")
    parser.add_argument("maps", nargs="*", choices=[*MAPS, []], help="which maps (default: all)")
    args = parser.parse_args()
    rows = []
    for name in args.maps or MAPS:
        map_, shape = study(name, 1 if args.full else 0)
        own = sensitivity_rows(map_)
        shown = [
            row | {"modes": f"{row['modes']:.1e}", "slope": f"{row['slope']:.3f}"} for row in own
        ]
        print(format_table(shown, list(own[0])).replace("nan", "  -"), flush=True)
        if name in ("held", "branch"):
            errors = envelope(shape, own)
            print(f"Envelope theorem, relative errors (target 1e-6): {errors}")
        print()
        rows += own
    curved = [row["slope"] for row in rows if not math.isnan(row["slope"])]
    print(
        f"{len(rows)} pairs, {len(rows) - len(curved)} of them linear. Slopes from "
        f"{min(curved):.3f} to {max(curved):.3f} (target 2 ± 0.05); modes agree to "
        f"{max(row['modes'] for row in rows):.1e} (target 1e-10)."
    )


if __name__ == "__main__":
    main()

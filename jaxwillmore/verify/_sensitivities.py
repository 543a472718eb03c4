"""Derivatives of outputs by parameters: forward against reverse mode, and Taylor's remainder.

A *map* takes a dictionary of scalar parameters to a dictionary of scalar outputs. It is compiled
twice, forward and reverse; all pairs of outputs and parameters come from these two.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import Nodes
from ..energies import OsmoticPressure, Pressure, SurfaceTension, Willmore
from ..equilibria import Equilibrium, resolve
from ..evolve import Stepper, replay
from ..flows import Loaded, WillmoreFlow
from ..mesh import SurfaceMesh
from ..surface import (
    area,
    area_radius,
    body_centroid,
    curvature_moments,
    harmonic_coefficients,
    principal_moments,
    reduced_volume,
    signed_distance,
    volume,
)

Scalars = dict[str, Float[Array, ""]]
Row = dict[str, Any]
# Remainders smaller than this, relative to the output, are rounding of the solvers.
FLOOR = 1e-10
# A parameter that moves an output by less than this part of what another one does is minor.
MINOR = 1e-3
_MAX_HARMONIC = 4


class Sensitivity(NamedTuple):
    """A map, where to differentiate it, and the largest change of each parameter."""

    name: str
    map: Callable[[Scalars], Scalars]
    at: Scalars
    steps: dict[str, float]


def sensitivity_rows(study: Sensitivity, halvings: int = 4) -> list[Row]:
    r"""One row per pair of output and parameter.

    Columns: `map`, `output`, `parameter`, the `derivative` $f'$, the relative difference `modes`
    between forward and reverse mode (0 where both vanish up to rounding; for a minor parameter,
    relative to a thousandth of what the strongest one does), and `slope`, the order in h of
    Taylor's remainder $|f(p + h) - f(p) - h f'|$: 2 when the derivative is right, 1 when it is
    wrong. It is taken from the three smallest of the steps `steps[p] / 2^k` whose remainder is
    above the rounding of the solvers; NaN where the output is linear in the parameter to that
    accuracy.
    """
    names = list(study.at)
    # Python numbers make weakly typed arrays, and every mixture of them would compile again.
    at = {name: jnp.asarray(value, jnp.float64) for name, value in study.at.items()}

    @jax.jit
    def forward(p, direction):
        return jax.jvp(study.map, (p,), (direction,))

    @jax.jit
    def reverse(p, weights):
        return jax.vjp(study.map, p)[1](weights)[0]

    zero = {name: jnp.zeros(()) for name in names}
    start, _ = forward(at, zero)
    slopes, remainders = {}, {}
    for name in names:
        _, slopes[name] = forward(at, zero | {name: jnp.ones(())})
        hs = study.steps[name] / 2.0 ** np.arange(halvings)
        values = [forward(at | {name: at[name] + h}, zero)[0] for h in hs]
        for output in start:
            remainders[output, name] = [
                (h, abs(float(value[output] - start[output] - h * slopes[name][output])))
                for h, value in zip(hs, values, strict=True)
            ]
    rows = []
    nothing = {output: jnp.zeros(()) for output in start}
    for output in start:
        backward = reverse(at, nothing | {output: jnp.ones(())})
        reach = max(abs(float(slopes[name][output]) * study.steps[name]) for name in names)
        for name in names:
            found, other = float(slopes[name][output]), float(backward[name])
            step = abs(study.steps[name])
            # A derivative that vanishes has no relative error.
            rounding = FLOOR * (abs(float(start[output])) + 1) / step
            vanishes = max(abs(found), abs(other)) < rounding
            size = max(abs(found), MINOR * reach / step)
            rows.append(
                {
                    "map": study.name,
                    "output": output,
                    "parameter": name,
                    "derivative": found,
                    "modes": 0.0 if vanishes else abs(other - found) / size,
                    "slope": _slope(remainders[output, name], float(start[output])),
                }
            )
    return rows


def _slope(remainders: Sequence[tuple[float, float]], value: float) -> float:
    """Least-squares order of the three smallest remainders above rounding, given with their h."""
    floor = FLOOR * (abs(value) + 1e-3)
    seen = [(abs(h), r) for h, r in remainders if r > floor][-3:]
    if len(seen) < 3:
        return math.nan
    h, r = np.log(np.array(seen)).T
    return float(np.polyfit(h, r, 1)[0])


def shape_outputs(mesh: SurfaceMesh, x: Nodes, points: Float[Array, "points 3"]) -> Scalars:
    """Numbers of a shape: one per kind, several of a kind in a fixed sum with uneven weights."""
    c = harmonic_coefficients(mesh, x, _MAX_HARMONIC)
    moments = curvature_moments(mesh, x, (1, 3))
    weighted = lambda a: jnp.vdot(a, jnp.cos(1.0 + 2.0 * jnp.arange(float(a.shape[0]))))
    return {
        "Willmore energy": Willmore()(mesh, x),
        "area": area(mesh, x),
        "volume": volume(mesh, x),
        "int H": moments[0],
        "int H^3": moments[1],
        "centroid": weighted(body_centroid(mesh, x)),
        "inertia": weighted(principal_moments(mesh, x)),
        "harmonics": weighted(c),
        "distances": weighted(signed_distance(mesh, x, points)),
    }


def _points(mesh: SurfaceMesh, x: Nodes) -> Float[Array, "points 3"]:
    """Targets around the surface, over the inside of every third cell."""
    middles = jnp.mean(x[mesh.cells[::3]], axis=1)
    return middles * jnp.linspace(0.9, 1.3, middles.shape[0])[:, None]


def _bump(x: Nodes) -> Nodes:
    """A change of shape that no symmetry makes vanish."""
    return jnp.sin(x @ jnp.array([[0.3, 1.1, 0.2], [-0.7, 0.4, 0.9], [0.5, -0.2, 0.8]]) + 0.4)


def run_sensitivity(
    mesh: SurfaceMesh, x: Nodes, n_steps: int = 3, *, held: bool = False
) -> Sensitivity:
    r"""The end of a trajectory by everything that enters it.

    Parameters: `b_b`, `H0`, the step `tau`, the amplitude `shape` of a change of the initial
    nodes; with `held` the `reduced_volume` and the `area` that are held, otherwise the tension
    `sigma`, the pressure `P`, and the osmotic constants `n`, `c_out` and `T`.
    """
    at = {"b_b": 0.6, "H0": 0.4, "tau": 1e-3, "shape": 0.0}
    steps = {"b_b": 0.04, "H0": 0.1, "tau": 6e-5, "shape": 0.01}
    if held:
        at |= {"reduced_volume": float(reduced_volume(mesh, x)), "area": float(area(mesh, x))}
        steps |= {"reduced_volume": -1e-3, "area": 0.01 * at["area"]}
    else:
        at |= {"sigma": 0.8, "P": 1.2, "n": 3.0, "c_out": 0.7, "T": 0.9}
        steps |= {name: 0.4 * at[name] for name in ("sigma", "P", "n", "c_out", "T")}
    points = _points(mesh, x)

    def flow(p):
        bending = WillmoreFlow(p["b_b"], p["H0"])
        if held:
            ball = p["area"] ** 1.5 / (6 * jnp.sqrt(jnp.pi))
            enclosed = p["reduced_volume"] * ball
            return Loaded(bending, fixed_area=p["area"], fixed_volume=enclosed)
        osmosis = OsmoticPressure(p["n"], p["c_out"], p["T"], 1.0)
        return Loaded(bending, SurfaceTension(p["sigma"]) + Pressure(p["P"]) + osmosis)

    start = {name: jnp.asarray(value, float) for name, value in at.items()}
    stepper = Stepper(flow(start), mesh, newton_tolerance=1e-12, max_newton=40)

    def end(p):
        times = p["tau"] * jnp.arange(n_steps + 1.0)
        x0 = x + p["shape"] * _bump(x)
        run = replay(flow(p), mesh, x0, times, stepper=stepper)
        return shape_outputs(mesh, run.x[-1], points)

    return Sensitivity("run, held" if held else "run, loaded", end, start, steps)


def equilibrium_sensitivity(shape: Equilibrium, *, held: bool = True) -> Sensitivity:
    r"""An equilibrium by everything it depends on; multipliers are outputs.

    Parameters: `b_b`, `H0` and, with `held`, the `area` and the `reduced_volume`; otherwise the
    tension `sigma` and the pressure `P`, prescribed at the values of the multipliers of `shape`.
    """
    p = shape.parameters
    at = {"b_b": p.bending_modulus, "H0": p.spontaneous_curvature}
    R = float(area_radius(shape.mesh, shape.x))
    b = float(p.bending_modulus)
    # Without constraints the shape is softer, and smaller steps show the same curvature.
    steps = {"b_b": 0.05 * b, "H0": 0.04 / R} if held else {"b_b": 0.015 * b, "H0": 0.015 / R}
    if held:
        at |= {"area": p.area, "reduced_volume": shape.reduced_volume}
        steps |= {"area": 0.02 * float(p.area), "reduced_volume": 2e-3}
    else:
        at |= {"sigma": p.tension, "P": p.pressure}
        steps |= {"sigma": 0.002 * float(p.tension), "P": 0.006 * float(p.pressure)}
        flags = lambda s: (s.fixed_area, s.fixed_volume)
        shape = eqx.tree_at(flags, shape, (False, False))
    points = _points(shape.mesh, shape.x)

    def found(q: Mapping[str, Array]):
        p = shape.parameters
        changed = [q["b_b"], q["H0"]]
        if held:
            ball = q["area"] ** 1.5 / (6 * jnp.sqrt(jnp.pi))
            changed += [q["area"], q["reduced_volume"] * ball, p.tension, p.pressure]
        else:
            changed += [p.area, p.volume, q["sigma"], q["P"]]
        again = resolve(shape, eqx.tree_at(_numbers, p, tuple(changed)), tolerance=1e-12)
        outputs = shape_outputs(shape.mesh, again.x, points)
        multipliers = {"tension": again.tension, "pressure": again.pressure}
        return outputs | {"bending energy": again.energy} | (multipliers if held else {})

    return Sensitivity("equilibrium, held" if held else "equilibrium, loaded", found, at, steps)


def _numbers(p):
    """The numbers among the parameters of an equilibrium."""
    return (
        p.bending_modulus,
        p.spontaneous_curvature,
        p.area,
        p.volume,
        p.tension,
        p.pressure,
    )

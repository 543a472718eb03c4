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
from ..flows import HelfrichFlow, Loads, System, WillmoreFlow, as_system
from ..mesh import SurfaceMesh
from ..surface import (
    angle_profile,
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
FLOOR = 3e-11
# A parameter is minor to an output that it moves by less than this part of what another one does,
# or, changed by a factor, by less than this part of that factor.
MINOR = 1e-3
_MAX_HARMONIC = 4
# Rays of a section askew to every symmetry, which meet the surfaces of these maps inside of cells.
_ANGLES, _AXIS = jnp.array([0.3, 1.55, 2.48, 3.28, 4.45, 5.24]), (0.3, -0.5, 0.8)


class Sensitivity(NamedTuple):
    """A map, where to differentiate it, and the largest change of each parameter."""

    name: str
    map: Callable[[Scalars], Scalars]
    at: Scalars
    steps: dict[str, float]


def sensitivity_rows(study: Sensitivity, halvings: int = 8) -> list[Row]:
    r"""One row per pair of output and parameter.

    Columns: `map`, `output`, `parameter`, the `derivative` $f'$, the relative difference `modes`
    between forward and reverse mode (0 where both vanish up to rounding; for a minor parameter,
    relative to a thousandth of what the strongest one does, or of the ratio of output and
    parameter: below that what is left of sums that cancel is rounding), and `slope`, the order in h
    of Taylor's remainder $|f(p + h) - f(p) - h f'|$: 2 when the derivative is right, 1 when it is
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
            ratio = abs(float(start[output]) / float(at[name])) if float(at[name]) else 0.0
            size = max(abs(found), MINOR * reach / step, MINOR * ratio)
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
        "profile": weighted(angle_profile(mesh, x, _ANGLES, axis=_AXIS)),
    }


def sample_points(mesh: SurfaceMesh, x: Nodes) -> Float[Array, "points 3"]:
    """Targets around the surface, over the inside of every third cell."""
    middles = jnp.mean(x[mesh.cells[::3]], axis=1)
    return middles * jnp.linspace(0.9, 1.3, middles.shape[0])[:, None]


def bump(x: Nodes) -> Nodes:
    """A change of shape that no symmetry makes vanish."""
    return jnp.sin(x @ jnp.array([[0.3, 1.1, 0.2], [-0.7, 0.4, 0.9], [0.5, -0.2, 0.8]]) + 0.4)


def waves_on(x: Nodes) -> Float[Array, "nodes 3"]:
    """Three patterns on the nodes, of order one."""
    return jnp.cos(x @ jnp.array([[0.9, -0.4, 0.7], [0.2, 1.2, -0.6], [-0.8, 0.5, 1.0]]) - 0.3)


def run_sensitivity(
    mesh: SurfaceMesh, x: Nodes, n_steps: int = 3, *, kind: str = "loaded"
) -> Sensitivity:
    r"""The end of a trajectory by everything that enters it.

    Parameters of all kinds: the step `tau` and the amplitude `shape` of a change of the initial
    nodes.

    - `"loaded"`: `b_b`, `H0`, the tension `sigma`, the pressure `P`, and the osmotic constants
      `n`, `c_out` and `T`.
    - `"held"`: `b_b`, `H0`, the `reduced_volume` and the `area` that are held; the multipliers of
      the last step are outputs.
    - `"fields"`: $b_b$, $H_0$ and $b_k$ are nodal fields, the parameters amplitudes of patterns in
      them.

    **Raises:** `ValueError` for another kind.
    """
    osmotic = {"sigma": 0.8, "P": 1.2, "n": 3.0, "c_out": 0.7, "T": 0.9}
    v, A = float(reduced_volume(mesh, x)), float(area(mesh, x))
    numbers, sizes = {"b_b": 0.6, "H0": 0.4}, {"b_b": 0.04, "H0": 0.1}
    if kind == "loaded":
        own, largest = numbers | osmotic, sizes | {name: 0.4 * a for name, a in osmotic.items()}
    elif kind == "held":
        own = numbers | {"reduced_volume": v, "area": A}
        largest = sizes | {"reduced_volume": -1e-3, "area": 0.01 * A}
    elif kind == "fields":
        own, largest = {"b_b": 0.2, "H0": 0.3, "b_k": 0.2}, {"b_b": 0.06, "H0": 0.1, "b_k": 0.1}
    else:
        raise ValueError(f"`kind` must be 'loaded', 'held' or 'fields'; got {kind!r}.")
    points, waves = sample_points(mesh, x), waves_on(x)

    def flow(p):
        if kind == "fields":
            b_b = 0.6 * (1 + p["b_b"] * waves[:, 0])
            return HelfrichFlow(b_b, 0.4 + p["H0"] * waves[:, 1], p["b_k"] * waves[:, 2])
        bending = WillmoreFlow(p["b_b"], p["H0"])
        if kind == "held":
            ball = p["area"] ** 1.5 / (6 * jnp.sqrt(jnp.pi))
            enclosed = p["reduced_volume"] * ball
            return System(bending, Loads(area=p["area"], volume=enclosed))
        osmosis = OsmoticPressure(p["n"], p["c_out"], p["T"], 1.0)
        return System(bending, Loads(SurfaceTension(p["sigma"]) + Pressure(p["P"]) + osmosis))

    at = own | {"tau": 1e-3, "shape": 0.0}
    start = {name: jnp.asarray(value, float) for name, value in at.items()}
    stepper = Stepper(flow(start), mesh, newton_tolerance=1e-12, max_newton=40)

    def end(p):
        times = p["tau"] * jnp.arange(n_steps + 1.0)
        x0 = x + p["shape"] * bump(x)
        run = replay(flow(p), mesh, x0, times, stepper=stepper)
        outputs = shape_outputs(mesh, run.x[-1], points)
        if kind == "held":
            outputs |= {name: run.multipliers[name][-1] for name in ("tension", "pressure")}
        return outputs | {"energy": as_system(flow(p)).energy(mesh, run.x[-1], {})}

    return Sensitivity(f"run, {kind}", end, start, largest | {"tau": 6e-5, "shape": 0.01})


def equilibrium_sensitivity(shape: Equilibrium, *, held: bool = True) -> Sensitivity:
    r"""An equilibrium by everything it depends on; multipliers are outputs.

    Parameters: `b_b`, `H0`; with `held` the `area` and the `reduced_volume` as far as the
    equilibrium holds them; for what it does not, and without `held`, the tension `sigma` and the
    pressure `P`, the latter prescribed at the values of the multipliers of `shape`; and the
    constants `n`, `c_out` and `T` of an osmotic pressure, if its energy has one.
    """
    p, R = shape.parameters, float(area_radius(shape.mesh, shape.x))
    b, sigma, P = (float(a) for a in (p.bending_modulus, shape.tension, shape.pressure))
    at = {"b_b": p.bending_modulus, "H0": p.spontaneous_curvature}
    # A shape of free volume is softer: smaller steps show the same curvature.
    soft = 1.0 if held and shape.fixed_volume else 0.3
    steps = {"b_b": 0.05 * soft * b, "H0": 0.025 * soft / R}
    if not held:
        flags = lambda s: (s.fixed_area, s.fixed_volume)
        shape = eqx.tree_at(flags, shape, (False, False))
    if shape.fixed_area:
        at, steps = at | {"area": p.area}, steps | {"area": 0.02 * soft**2 * float(p.area)}
    else:
        at, steps = at | {"sigma": p.tension}, steps | {"sigma": 0.002 * sigma}
    if shape.fixed_volume:
        at, steps = at | {"reduced_volume": shape.reduced_volume}, steps | {"reduced_volume": 2e-3}
    else:
        at, steps = at | {"P": p.pressure}, steps | {"P": 0.006 * P}
    constants = dict(zip(("n", "c_out", "T"), _osmotic(p), strict=False))
    at |= constants
    steps |= {name: 0.003 * float(value) for name, value in constants.items()}
    points = sample_points(shape.mesh, shape.x)

    def found(q: Mapping[str, Array]):
        p = shape.parameters
        A = q["area"] if shape.fixed_area else p.area
        ball = A**1.5 / (6 * jnp.sqrt(jnp.pi))
        V = q["reduced_volume"] * ball if shape.fixed_volume else p.volume
        applied = q.get("sigma", p.tension), q.get("P", p.pressure)
        p = eqx.tree_at(_numbers, p, (q["b_b"], q["H0"], A, V, *applied))
        if constants:
            p = eqx.tree_at(_osmotic, p, [q[name] for name in constants])
        again = resolve(shape, p, tolerance=1e-12)
        outputs = shape_outputs(shape.mesh, again.x, points)
        outputs["bending energy"] = again.energy
        if shape.fixed_area:
            outputs["tension"] = again.tension
        if shape.fixed_volume or constants:
            outputs["pressure"] = again.pressure
        if constants:
            outputs["osmotic energy"] = again.global_energy
        return outputs

    kind = "held" if shape.fixed_volume else "osmosis" if constants else "loaded"
    return Sensitivity(f"equilibrium, {kind}", found, at, steps)


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


def _osmotic(p):
    """Solute, concentration outside and temperature, if there is an osmotic pressure."""

    def plain(energy):
        # Not `terms_of`: that multiplies factors, and here leaves are only pointed at.
        parts = getattr(energy, "terms", None)
        return [energy] if parts is None else [term for part in parts for term in plain(part)]

    for term in plain(p.global_energy):
        if isinstance(term, OsmoticPressure):
            return [term.solute_amount, term.ambient_concentration, term.temperature]
    return []

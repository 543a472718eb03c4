"""Derivatives of runs and equilibria of two phases by everything that enters them."""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._types import Nodes
from ..energies import Mixture, TwoPhase
from ..equilibria import equilibrium, resolve
from ..evolve import Stepper, replay
from ..fem import integrate
from ..flows import CahnHilliard, gradient_flow
from ..mesh import SurfaceMesh
from ..phases import stripe
from ..surface import area, reduced_volume, volume
from ._sensitivities import Scalars, Sensitivity, bump, sample_points, shape_outputs, waves_on


def _two_phase_energy(p) -> TwoPhase:
    """Phase 0 is fixed, phase 1 has the parameters."""
    moduli = Mixture(0.6, p["b_b"]), Mixture(0.2, p["H0"]), Mixture(0.0, p["b_k"])
    return TwoPhase(*moduli, p["lambda"], p["width"])


_OF_TWO_PHASES = {"lambda": 2.0, "width": 0.55, "b_b": 0.8, "H0": 0.9, "b_k": -0.4}
_STEPS = {"lambda": 0.1, "width": 0.025, "b_b": 0.05, "H0": 0.1, "b_k": 0.1}


def _moments(mesh: SurfaceMesh, x: Nodes, c) -> Scalars:
    """Numbers of a concentration on a surface."""
    moments = integrate(mesh, x, lambda _, f: f.c.value ** jnp.array([2.0, 3.0]), {"c": c})
    return {"int c^2": moments[0], "int c^3": moments[1]}


def two_phase_run_sensitivity(mesh: SurfaceMesh, x: Nodes, n_steps: int = 2) -> Sensitivity:
    r"""The end of a coupled run of two phases by everything that enters it.

    Cahn–Hilliard kinetics, area and volume held. Parameters: line tension `lambda`, `width`,
    `mobility`, `b_b`, `H0` and `b_k` of phase 1, the amplitude `c` of a change of the initial
    concentration, the step `tau` and the amplitude `shape` of a change of the initial nodes.
    Moments of the concentration and multipliers are outputs.
    """
    at = _OF_TWO_PHASES | {"mobility": 0.7, "c": 0.0, "tau": 2e-3, "shape": 0.0}
    start = {name: jnp.asarray(value, float) for name, value in at.items()}
    points, waves = sample_points(mesh, x), waves_on(x)
    c = stripe(mesh, x, _OF_TWO_PHASES["width"], 0.5)

    def flow(p, x):
        kinetics = CahnHilliard(p["mobility"])
        A, V = area(mesh, x), volume(mesh, x)
        return gradient_flow(_two_phase_energy(p), phase=kinetics, area=A, volume=V)

    stepper = Stepper(flow(start, x), mesh, newton_tolerance=1e-12, max_newton=40)

    def end(p):
        times, x0 = p["tau"] * jnp.arange(n_steps + 1.0), x + p["shape"] * bump(x)
        law, fields = flow(p, x0), {"c": c + p["c"] * waves[:, 1]}
        run = replay(law, mesh, x0, times, stepper=stepper, initial=fields)
        last, fields = run.x[-1], {"c": run.fields["c"][-1]}
        outputs = shape_outputs(mesh, last, points) | _moments(mesh, last, fields["c"])
        outputs |= {name: run.multipliers[name][-1] for name in ("tension", "pressure")}
        return outputs | {"energy": _two_phase_energy(p)(mesh, last, fields)}

    own = {"mobility": 0.2, "c": 0.05, "tau": 1e-4, "shape": 0.01}
    return Sensitivity("run, phases", end, start, _STEPS | own)


def two_phase_sensitivity(mesh: SurfaceMesh, x: Nodes) -> Sensitivity:
    r"""An equilibrium of two phases with one interface by everything it depends on.

    Parameters: line tension `lambda`, `width`, `b_b`, `H0` and `b_k` of phase 1, the
    `reduced_volume` and the `mean` concentration. Tension, pressure, chemical potential and moments
    of the concentration are outputs. It begins near `x`, which should be oblong.
    """
    energy = _two_phase_energy(_OF_TWO_PHASES)
    c = stripe(mesh, x, _OF_TWO_PHASES["width"], 0.5)
    v = float(reduced_volume(mesh, x))
    shape = equilibrium(mesh, x, energy, c=c, reduced_volume=v, stability=False)
    points, p0 = sample_points(mesh, shape.x), shape.parameters
    at = dict(_OF_TWO_PHASES) | {"reduced_volume": shape.reduced_volume}
    at |= {"mean": shape.mean_concentration}

    def found(q: Mapping[str, Array]):
        ball = p0.area**1.5 / (6 * jnp.sqrt(jnp.pi))
        numbers = _two_phase_energy(q), q["reduced_volume"] * ball, q["mean"] * p0.area
        p = eqx.tree_at(lambda p: (p.two_phase, p.volume, p.amount), p0, numbers)
        again = resolve(shape, p, tolerance=1e-12)
        assert again.c is not None and again.chemical_potential is not None
        outputs = shape_outputs(mesh, again.x, points) | _moments(mesh, again.x, again.c)
        return outputs | {
            "energy": again.total_energy,
            "tension": again.tension,
            "pressure": again.pressure,
            "chemical potential": again.chemical_potential,
        }

    start = {name: jnp.asarray(value, float) for name, value in at.items()}
    own = {"reduced_volume": 2e-3, "mean": 2e-3}
    return Sensitivity("equilibrium, phases", found, start, _STEPS | own)

"""Lines in the space of parameters, which branches follow."""

import equinox as eqx
import jax.numpy as jnp

from ..energies import QuarticWell, TwoPhase
from ._parameters import Parameters
from ._shape import Equilibrium, no_direction

PARAMETERS = (
    "reduced_volume",
    "spontaneous_curvature",
    "pressure",
    "mean",
    "line_tension",
    "interface_width",
)


def line(start: Equilibrium, parameter: str) -> tuple[Parameters, Parameters, float, float]:
    """Base, direction, size of a typical change, and value at the start, of the parameter line."""
    p, units = start.parameters, start.units
    scaled = units.parameters(p)
    zero = jnp.zeros(())
    nothing = no_direction(scaled)
    if parameter == "reduced_volume":
        if not (start.fixed_area and start.fixed_volume):
            raise ValueError("A branch in `reduced_volume` needs area and volume held.")
        scale, value = 0.5, float(start.reduced_volume)
        rate = scaled.area**1.5 / (6 * jnp.sqrt(jnp.pi))
        where = lambda q: q.volume
    elif parameter == "spontaneous_curvature":
        if p.two_phase is not None:
            raise ValueError("A branch in `spontaneous_curvature` needs a membrane of one phase.")
        scale, value = 1 / float(start.area_radius), float(p.spontaneous_curvature)
        rate, where = units.length, lambda q: q.spontaneous_curvature
    elif parameter == "pressure":
        if start.fixed_volume:
            raise ValueError("A branch in `pressure` needs a free volume.")
        scale = 10 * float(units.kappa / units.length**3)
        value = float(p.pressure)
        rate, where = units.length**3 / units.kappa, lambda q: q.pressure
    elif parameter in ("mean", "line_tension", "interface_width"):
        scale, value, rate, where = _phase_line(start, parameter, scaled)
    else:
        raise ValueError(f"`parameter` must be one of {PARAMETERS}; got {parameter!r}.")
    base = eqx.tree_at(where, scaled, zero)
    return base, eqx.tree_at(where, nothing, rate * scale), scale, value


def _phase_line(start: Equilibrium, parameter: str, scaled: Parameters):
    """Scale, value, rate and place of a parameter of a membrane of two phases."""
    phases = start.parameters.two_phase
    if not isinstance(phases, TwoPhase):
        raise ValueError(f"A branch in `{parameter}` needs a membrane of two phases.")
    if parameter == "mean":
        if not start.fixed_area:
            raise ValueError("A branch in `mean` needs a held area.")
        value = start.mean_concentration
        assert value is not None
        return 0.5, float(value), scaled.area, lambda q: q.amount
    if not isinstance(phases.well, QuarticWell):
        raise ValueError(
            f"A branch in `{parameter}` needs a `QuarticWell`; got {type(phases.well).__name__}, "
            "whose parameters are others."
        )
    value = float(getattr(phases.well, parameter))
    # Of the energy in the units of the user, which is scaled when it is evaluated.
    where = lambda q: getattr(q.two_phase.energy.mixing.well, parameter)
    return value, value, jnp.ones(()), where

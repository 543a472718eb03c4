"""The flow that a case asks for."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..cases import LAWS, Case, CaseError, ball_volume, check_isoperimetric
from ..flows import (
    AbstractLaw,
    Loads,
    MinimalDeformation,
    System,
    gradient_flow,
)
from ..mesh import SurfaceMesh
from ..surface import area, volume
from ._energies import global_energy
from ._phase import kinetics, mixing_energy

# Above this reduced volume the gradients of area and volume are too nearly parallel to leave from.
ROUND = 0.998


class Ramp(eqx.Module):
    """A number that goes linearly in time from one value to another, and stays there."""

    start: Float[Array, ""]
    end: Float[Array, ""]
    t0: Float[Array, ""]
    duration: Float[Array, ""]

    def __init__(self, start, end, t0, duration):
        self.start, self.end = jnp.asarray(start, float), jnp.asarray(end, float)
        self.t0, self.duration = jnp.asarray(t0, float), jnp.asarray(duration, float)

    def __call__(self, t) -> Float[Array, ""]:
        part = jnp.clip((t - self.t0) / self.duration, 0.0, 1.0)
        return self.start + part * (self.end - self.start)


def flow_of(case: Case, mesh: SurfaceMesh, x) -> System:
    """The law of `[flow]` with the energies and the constraints of the case.

    **Raises:** `CaseError` for constraints that no surface satisfies, that the start does not
    satisfy, or that the scheme or the law does not have.
    """
    if case.flow.kind == "phase":
        return gradient_flow(mixing_energy(case), phase=kinetics(case))
    laws: list[AbstractLaw | System] = (
        [LAWS[case.flow.kind](case.energy, case.flow)] if case.phase is None else [_coupled(case)]
    )
    held_area = _held_area(case, float(area(mesh, x)))
    held_volume = _held_volume(case, float(area(mesh, x)), float(volume(mesh, x)))
    loads = global_energy(case, mesh, x)
    if not (loads is None and held_area is None and held_volume is None):
        laws.append(_loads(case, loads, held_area, held_volume))
    if case.flow.tangential == "minimal-deformation":
        laws.append(MinimalDeformation())
    return System(*laws)


def _coupled(case: Case) -> System:
    """Both phases, their kinetics and what keeps them from drifting, without loads."""
    return gradient_flow(
        mixing_energy(case),
        phase=kinetics(case),
        consistency=case.flow.consistency,
        consistency_weight=case.flow.consistency_weight,
    )


def _loads(case: Case, energy, held_area, held_volume) -> Loads:
    if case.flow.scheme != "implicit":
        problem = (
            'constraints and energies of the whole surface need scheme = "implicit"; the linearly '
            "implicit scheme has no unknowns for them."
        )
        raise CaseError(problem, section="flow", key="scheme", got=case.flow.scheme)
    try:
        return Loads(energy, area=held_area, volume=held_volume)
    except ValueError as error:
        raise CaseError(str(error), section="constraints") from error


def _held_area(case: Case, now: float) -> float | None:
    """The area to hold, or `None`; a flow starts on its constraints."""
    target = case.constraints.area
    if target is None or isinstance(target, str):  # "initial"
        return None if target is None else now
    if abs(target / now - 1) > 1e-6:
        problem = (
            f"the start has the area {now:.10g}, not {target:.10g}; a flow starts on its "
            'constraints. Scale the surface, or write "initial".'
        )
        raise CaseError(problem, section="constraints", key="area", got=target)
    return target


def _held_volume(case: Case, area_now: float, now: float) -> float | Ramp | None:
    """The volume to hold or to go to, or `None`."""
    constraints = case.constraints
    key = "volume" if constraints.reduced_volume is None else "reduced_volume"
    given = getattr(constraints, key)
    if given is None or isinstance(given, str):  # "initial"
        return None if given is None else now
    target = given if key == "volume" else given * ball_volume(area_now)
    if constraints.area is not None:
        check_isoperimetric(area_now, target)
    if constraints.ramp is None:
        if abs(target / now - 1) <= 1e-6:
            return target
        has = now if key == "volume" else now / ball_volume(area_now)
        problem = (
            f"the start has {key} {has:.10g}, not {given:.10g}; a flow starts on its "
            'constraints. Add `ramp`, the time in which the volume goes there, or write "initial".'
        )
        raise CaseError(problem, section="constraints", key=key, got=given)
    if case.time is not None and constraints.ramp > case.time.t1 - case.time.t0:
        allowed = f"<= t1 - t0 = {case.time.t1 - case.time.t0:g}, or the volume does not arrive"
        problem = f"must be {allowed}; got {constraints.ramp:g}."
        raise CaseError(problem, section="constraints", key="ramp", allowed=allowed)
    round_start = constraints.area is not None and now > ROUND * ball_volume(area_now)
    if round_start and target < now:
        problem = (
            "the start is a sphere, from which no small displacement keeps the area and lowers "
            "the volume; start from an ellipsoid or another shape that is not round."
        )
        raise CaseError(problem, section="constraints", key=key, got=given)
    t0 = 0.0 if case.time is None else case.time.t0
    return Ramp(now, target, t0, constraints.ramp)

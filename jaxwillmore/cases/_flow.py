"""The flow that a case asks for."""

from ..energies import Pressure, SurfaceTension
from ..flows import (
    AbstractFlow,
    Loaded,
    MeanCurvatureFlow,
    MinimalDeformation,
    SurfaceDiffusion,
    WillmoreFlow,
)
from ..mesh import SurfaceMesh
from ..surface import area, volume
from ._case import Case
from ._error import CaseError


def flow_of(case: Case, mesh: SurfaceMesh, x) -> AbstractFlow:
    """The law of `[flow]` with the energy, the loads and the constraints of the case.

    **Raises:** `CaseError` for constraints that no surface satisfies, that the start does not
    satisfy, or that the scheme or the law does not have.
    """
    flow = _law(case)
    if case.flow.tangential == "minimal-deformation":
        flow = MinimalDeformation(flow)
    held = {
        "area": _held(case, "area", float(area(mesh, x))),
        "volume": _held(case, "volume", float(volume(mesh, x))),
    }
    if not any((case.energy.tension, case.energy.pressure, *held.values())):
        return flow
    if case.flow.scheme != "implicit":
        problem = (
            'constraints, tension and pressure need scheme = "implicit"; the linearly implicit '
            "scheme has no unknowns for them."
        )
        raise CaseError(problem, section="flow", key="scheme", got=case.flow.scheme)
    loads = SurfaceTension(case.energy.tension) + Pressure(case.energy.pressure)
    try:
        return Loaded(flow, loads, fixed_area=held["area"], fixed_volume=held["volume"])
    except ValueError as error:
        raise CaseError(str(error), section="constraints") from error


def _law(case: Case) -> AbstractFlow:
    energy, flow = case.energy, case.flow
    if flow.kind == "willmore":
        return WillmoreFlow(
            bending_modulus=energy.bending_modulus,
            spontaneous_curvature=energy.spontaneous_curvature,
            consistency=flow.consistency,
            consistency_weight=flow.consistency_weight,
        )
    if flow.kind == "mean-curvature":
        return MeanCurvatureFlow(consistency=flow.consistency)
    return SurfaceDiffusion(consistency=flow.consistency)


def _held(case: Case, key: str, now: float) -> float | None:
    """The value to hold, or `None`; a flow starts on its constraints."""
    target = getattr(case.constraints, key)
    if target is None:
        return None
    if target == "initial":
        return now
    if abs(target / now - 1) > 1e-6:
        problem = (
            f"the start has the {key} {now:.10g}, not {target:.10g}; a flow starts on its "
            'constraints. Scale the surface, or write "initial".'
        )
        raise CaseError(problem, section="constraints", key=key, got=target)
    return target

"""The laws of motion that `kind` in [flow] names: one function and one entry each."""

from collections.abc import Callable
from typing import Any

from ..flows import AbstractLaw, MeanCurvatureFlow, SurfaceDiffusion, WillmoreFlow


def _willmore(energy, flow) -> AbstractLaw:
    return WillmoreFlow(
        bending_modulus=energy.bending_modulus,
        spontaneous_curvature=energy.spontaneous_curvature,
        consistency=flow.consistency,
        consistency_weight=flow.consistency_weight,
    )


def _mean_curvature(energy, flow) -> AbstractLaw:
    del energy
    return MeanCurvatureFlow(consistency=flow.consistency)


def _surface_diffusion(energy, flow) -> AbstractLaw:
    del energy
    return SurfaceDiffusion(consistency=flow.consistency)


LAWS: dict[str, Callable[[Any, Any], AbstractLaw]] = {
    "willmore": _willmore,
    "mean-curvature": _mean_curvature,
    "surface-diffusion": _surface_diffusion,
}
"""The law of a name, from the sections `EnergyCase` and `FlowCase`."""

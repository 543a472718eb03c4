"""The numbers that are left at the end."""

import dataclasses
import importlib.metadata
import math
import platform
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import numpy as np

from .._version import __version__
from ..cases import Case
from ..energies import Willmore, willmore_of_field
from ..equilibria import Equilibrium
from ..evolve import State, diagnostics
from ..flows import System
from ..health import HealthWarning, health_warnings, least_willmore
from ..mesh import SurfaceMesh, quality
from ..surface import area, centroid, volume
from ._energies import bending_energy
from ._phase_record import phase_of_equilibrium, phase_summary

_LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "scipy", "trimesh")
_MEASURES = ("energy", "willmore", "willmore_of_field", "area", "volume", "reduced_volume")
_FIRST_COLUMNS = ("step", "t", "dt", *_MEASURES, "min_angle", "max_angle")


def row_of(record: dict[str, Any]) -> dict[str, Any]:
    """The columns of `history.csv` in an order for readers."""
    return {name: record[name] for name in _FIRST_COLUMNS if name in record} | record


def first_record(flow: System, state: State) -> dict[str, Any]:
    """The row of `history.csv` for the start, with the columns of every later row."""
    values = diagnostics(flow, state.mesh, state.x, state.fields)
    row = {"step": 0, "dt": 0.0, "error": 0.0, "t": state.t}
    row |= {name: float(value) for name, value in values.items()}
    # Multipliers belong to steps; before the first one there are none.
    row |= {name: math.nan for name in flow.global_names}
    return row | {"newton_iterations": 0, "krylov_iterations": 0, "rejected_steps": 0}


def warnings_of(case: Case, mesh: SurfaceMesh, x, H) -> tuple[HealthWarning, ...]:
    """The warnings of the last shape, piercing triangles among them where the case asks."""
    return health_warnings(mesh, x, H, self_intersection=case.output.self_intersection)


def measures_of(mesh: SurfaceMesh, x, H, energy: float) -> dict[str, float]:
    """Energies and sizes of a surface, under the names of the columns of `history.csv`."""
    of_x, of_field, A, V = (float(number) for number in _measures(mesh, x, H))
    numbers = energy, of_x, of_field, A, V, 6 * math.sqrt(math.pi) * V / A**1.5
    return dict(zip(_MEASURES, numbers, strict=True))


@eqx.filter_jit
def _measures(mesh, x, H):
    return Willmore()(mesh, x), willmore_of_field(mesh, x, H), area(mesh, x), volume(mesh, x)


def end_of_flow(case: Case, state: State, rows: list[dict]) -> dict[str, Any]:
    """Energies, multipliers and mesh of the last state of a flow; `rows` is its history."""
    last, mesh = rows[-1], state.mesh
    bending = None
    if case.flow.kind == "willmore" and case.phase is None:
        b = case.energy.bending_modulus
        bending = float(eqx.filter_jit(bending_energy(case))(mesh, state.x)) / (16 * math.pi * b)
    multipliers = None
    if "tension" in last:
        scaled = _scaled(case, last["area"], last["tension"], last["pressure"])
        multipliers = {**scaled, "curvature": last["curvature_multiplier"]}
    return {
        **{name: last[name] for name in _MEASURES if name in last},
        "phase": None if case.phase is None else phase_summary(last),
        "gaussian_energy": gaussian_energy(case, mesh),
        "bending_over_8pi_kappa": bending,
        "multipliers": multipliers,
        "stationarity": last["stationarity"],
        "negative_directions": None,
        "start": {name: rows[0][name] for name in _MEASURES if name in last},
        **_surface(mesh, state.x),
    }


def end_of_equilibrium(case: Case, shape: Equilibrium, H, start: dict[str, float]):
    """The same for an equilibrium; `start` are the measures of the surface it started from."""
    mesh, x = shape.mesh, shape.x
    scaled = _scaled(
        case, float(shape.parameters.area), float(shape.tension), float(shape.pressure)
    )
    return {
        **measures_of(mesh, x, H, total_energy(shape)),
        "phase": None if shape.c is None else phase_of_equilibrium(shape),
        "gaussian_energy": gaussian_energy(case, mesh),
        "bending_over_8pi_kappa": float(shape.bending_over_8pi_kappa),
        "multipliers": {**scaled, "curvature": float(shape.curvature_multiplier)},
        "stationarity": shape.residual,
        "search": shape.stats.get("search", "stationary"),
        "moved": shape.stats.get("moved"),
        "lost_symmetry": list(shape.stats.get("lost", ())),
        "energy_error": shape.energy_error,
        "negative_directions": shape.negative_directions,
        "eigenvalues": list(shape.eigenvalues),
        "total_mean_curvature": float(shape.total_mean_curvature),
        "start": start,
        **_surface(mesh, x),
    }


def total_energy(shape: Equilibrium) -> float:
    """All energies, with the work of an applied tension and pressure."""
    p = shape.parameters
    work = 0.0 if shape.fixed_area else float(p.tension * p.area)
    work -= 0.0 if shape.fixed_volume else float(p.pressure * p.volume)
    return float(shape.total_energy) + work


def gaussian_energy(case: Case, mesh: SurfaceMesh) -> float:
    """∫ b_k K = 2π χ b_k; it does no work and is not part of `energy`."""
    b_k = case.energy.gaussian_modulus
    if case.phase is not None and case.phase.gaussian_modulus is not None:
        # Where it differs it does work, and is part of the energy.
        b_k = case.phase.gaussian_modulus[0] if len(set(case.phase.gaussian_modulus)) == 1 else 0.0
    return 2 * math.pi * mesh.euler_characteristic * b_k


def _scaled(case: Case, area: float, tension: float, pressure: float) -> dict[str, float]:
    """Tension and pressure, also in units of κ = 2 b_b (of the phase c = 0) and R0 = √(A/4π)."""
    b = case.energy.bending_modulus
    if case.phase is not None and case.phase.bending_modulus is not None:
        b = case.phase.bending_modulus[0]
    kappa, R0 = 2 * b, math.sqrt(area / (4 * math.pi))
    return {
        "tension": tension,
        "pressure": pressure,
        "scaled_tension": tension * R0**2 / kappa,
        "scaled_pressure": pressure * R0**3 / kappa,
    }


def _surface(mesh: SurfaceMesh, x) -> dict[str, Any]:
    return {
        "euler_characteristic": mesh.euler_characteristic,
        "radius_spread": radius_spread(mesh, x) if mesh.genus == 0 else None,
        "quality": dataclasses.asdict(quality(mesh, x)),
        "nodes": mesh.n_nodes,
        "cells": mesh.n_cells,
        "degree": mesh.degree,
    }


def health_of(warnings: Iterable[HealthWarning]) -> list[dict[str, Any]]:
    """What `summary.json` says under `health`."""
    return [dataclasses.asdict(warning) for warning in warnings]


def provenance(wall_seconds: float) -> dict[str, Any]:
    """How long it took, and with what."""
    return {
        "wall_seconds": wall_seconds,
        "versions": {
            "jaxwillmore": __version__,
            "python": platform.python_version(),
            **libraries(),
        },
    }


def libraries() -> dict[str, str]:
    """Versions of what numbers depend on."""
    return {name: importlib.metadata.version(name) for name in _LIBRARIES}


def radius_spread(mesh: SurfaceMesh, x) -> float:
    """(largest − smallest) / mean distance of the nodes from the centre of area; 0 on a sphere."""
    radii = np.linalg.norm(np.asarray(x) - np.asarray(centroid(mesh, x)), axis=1)
    return float(np.ptp(radii) / radii.mean())


def reference_energies(genus: int) -> dict[str, float]:
    """The least ½∫H² of all surfaces of this genus."""
    return {"8π" if genus == 0 else "4π²": least_willmore(genus)}

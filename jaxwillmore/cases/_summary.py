"""The numbers a run ends with."""

import dataclasses
import importlib.metadata
import math
import platform
from typing import Any

import numpy as np

from .._version import __version__
from ..evolve import Solution, State, diagnostics, message, name_of
from ..flows import AbstractFlow
from ..mesh import SurfaceMesh, quality
from ..surface import centroid
from ._case import Case

_LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "scipy", "trimesh")
_MEASURES = ("energy", "willmore", "willmore_of_field", "area", "volume", "reduced_volume")


_FIRST_COLUMNS = ("step", "t", "dt", *_MEASURES, "min_angle", "max_angle")


def row_of(record: dict[str, Any]) -> dict[str, Any]:
    """The columns of `history.csv` in an order for readers."""
    return {name: record[name] for name in _FIRST_COLUMNS} | record


def first_record(flow: AbstractFlow, mesh: SurfaceMesh, state: State) -> dict[str, Any]:
    """The row of `history.csv` for the start, with the columns of every later row."""
    values = diagnostics(flow, mesh, state.x, state.fields)
    row = {"step": 0, "dt": 0.0, "error": 0.0, "t": state.t}
    row |= {name: float(value) for name, value in values.items()}
    # Multipliers belong to steps; before the first one there are none.
    row |= {name: math.nan for name in flow.global_names}
    return row | {"newton_iterations": 0, "krylov_iterations": 0, "rejected_steps": 0}


def summary_of(
    case: Case, solution: Solution, rows: list[dict[str, Any]], wall_seconds: float
) -> dict[str, Any]:
    """What `summary.json` says; `rows` is the history, start included."""
    mesh, state, stats = solution.mesh, solution.state, solution.stats
    return {
        "status": name_of(solution.result),
        "message": message(solution.result),
        "t": state.t,
        "steps": stats["steps"],
        "rejected_steps": stats["rejected_steps"],
        "newton_iterations": stats["newton_iterations"],
        "krylov_iterations": stats["linear_iterations"],
        **{name: rows[-1][name] for name in _MEASURES},
        "bending_over_8pi_kappa": _bending(case, rows[-1]),
        "multipliers": _multipliers(case, rows[-1]),
        "start": {name: rows[0][name] for name in _MEASURES},
        "euler_characteristic": mesh.euler_characteristic,
        "radius_spread": radius_spread(mesh, state.x) if mesh.genus == 0 else None,
        "quality": dataclasses.asdict(quality(mesh, state.x)),
        "nodes": mesh.n_nodes,
        "cells": mesh.n_cells,
        "degree": mesh.degree,
        "wall_seconds": wall_seconds,
        "versions": {
            "jaxwillmore": __version__,
            "python": platform.python_version(),
            **{name: importlib.metadata.version(name) for name in _LIBRARIES},
        },
    }


def _bending(case: Case, row: dict[str, Any]) -> float | None:
    """E/(8πκ) with E the bending energy alone and κ = 2 b; 1 on a sphere without H0."""
    if case.flow.kind != "willmore":
        return None
    loads = case.energy.tension * row["area"] - case.energy.pressure * row["volume"]
    return (row["energy"] - loads) / (16 * math.pi * case.energy.bending_modulus)


def _multipliers(case: Case, row: dict[str, Any]) -> dict[str, float] | None:
    """Tension and pressure of the last step, also in units of κ = 2 b and R0 = √(A/4π)."""
    if "tension" not in row:
        return None
    kappa, R0 = 2 * case.energy.bending_modulus, math.sqrt(row["area"] / (4 * math.pi))
    return {
        "tension": row["tension"],
        "pressure": row["pressure"],
        "tension_R0^2_over_kappa": row["tension"] * R0**2 / kappa,
        "pressure_R0^3_over_kappa": row["pressure"] * R0**3 / kappa,
    }


def radius_spread(mesh: SurfaceMesh, x) -> float:
    """(largest − smallest) / mean distance of the nodes from the centre of area; 0 on a sphere."""
    radii = np.linalg.norm(np.asarray(x) - np.asarray(centroid(mesh, x)), axis=1)
    return float(np.ptp(radii) / radii.mean())


def reference_energies(genus: int) -> dict[str, float]:
    """The least ½∫H² of all surfaces of this genus, where it is known."""
    return {0: {"8π": 8 * math.pi}, 1: {"4π²": 4 * math.pi**2}}.get(genus, {})

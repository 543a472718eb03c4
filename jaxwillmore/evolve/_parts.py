"""A solution taken apart into words and arrays, as files hold it, and put together again."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..mesh import SurfaceMesh
from ._continuation import Continuation, Kept, Origin
from ._remeshing import NewMesh
from ._solution import Solution, State, name_of, result_named
from ._step import StepData
from ._stepper import History
from ._whole import check_whole

_NUMBERS = ("dt", "energy", "size", "floor", "least")
_MAP = ("nodes", "weights", "offset")


def parts_of(solution: Solution) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What JSON can say of a solution, and its arrays by name; every digit is in one of them."""
    c, mesh, states = solution.continuation, solution.mesh, (solution.state, *solution.saved)
    meshes = _Distinct()
    arrays: dict[str, Any] = {
        "cells": c.origin.cells,
        "times": np.asarray(solution.times, float),
        "numbers": np.asarray([getattr(c, name) for name in _NUMBERS], float),
        "x0": c.origin.x0,
    }
    arrays |= _fields("history", c.history)
    arrays |= {f"parameters.{k}": p for k, p in enumerate(c.origin.parameters)}
    for k, state in enumerate(states):
        arrays[f"states.{k}.x"] = state.x
        arrays |= {f"states.{k}.fields.{name}": a for name, a in state.fields.items()}
    columns = list(solution.records[0]) if solution.records else []
    for k, name in enumerate(columns):
        arrays[f"records.{k}"] = np.asarray([record[name] for record in solution.records])
    if c.kept is not None:
        arrays |= _fields("kept", c.kept.data) | {"kept.y": c.kept.y}
    words = {
        "degree": mesh.degree,
        "n_nodes": mesh.n_nodes,
        "result": name_of(solution.result),
        "stats": solution.stats,
        "states": [
            {"t": s.t, "fields": list(s.fields), "mesh": meshes.number(s.mesh)} for s in states
        ],
        "new_meshes": [
            {"step": new.step, "t": new.t, "mesh": meshes.number(new.mesh), "changes": new.changes}
            for new in solution.new_meshes
        ],
        "columns": columns,
        "settings": [list(pair) for pair in c.origin.settings],
        "n_parameters": len(c.origin.parameters),
        "rejections": c.rejections,
        "kept": None if c.kept is None else c.kept.is_whole,
    }
    for k, new in enumerate(solution.new_meshes):
        arrays |= {f"new_meshes.{k}.{name}": getattr(new, name) for name in _MAP}
    words["n_meshes"] = len(meshes.all)
    arrays |= {f"meshes.{k}": each.cells for k, each in enumerate(meshes.all)}
    return words, {name: np.asarray(array) for name, array in arrays.items()}


class _Distinct:
    """Meshes, each once."""

    def __init__(self):
        self.all: list[SurfaceMesh] = []

    def number(self, mesh: SurfaceMesh) -> int:
        """Where a mesh stands, which is added where it is new."""
        for k, known in enumerate(self.all):
            if known is mesh or np.array_equal(known.cells, mesh.cells):
                return k
        self.all.append(mesh)
        return len(self.all) - 1


def solution_of(words: dict[str, Any], arrays: dict[str, np.ndarray]) -> Solution:
    """The solution that `parts_of` was given.

    **Raises:** `KeyError`, `TypeError` or `ValueError` where these are not its parts, or do not
    fit together.
    """
    # By number: one that is not there is a `KeyError`, and -1 is none.
    meshes = {
        k: SurfaceMesh(arrays[f"meshes.{k}"], degree=words["degree"], n_nodes=words["n_nodes"])
        for k in range(words["n_meshes"])
    }
    states = [
        State(
            said["t"],
            jnp.asarray(arrays[f"states.{k}.x"]),
            {name: jnp.asarray(arrays[f"states.{k}.fields.{name}"]) for name in said["fields"]},
            meshes[said["mesh"]],
        )
        for k, said in enumerate(words["states"])
    ]
    columns = [arrays[f"records.{k}"].tolist() for k in range(len(words["columns"]))]
    records = [dict(zip(words["columns"], row, strict=True)) for row in zip(*columns, strict=True)]
    settings = tuple((name, value) for name, value in words["settings"])
    parameters = tuple(arrays[f"parameters.{k}"] for k in range(words["n_parameters"]))
    kept = None
    if words["kept"] is not None:
        data = StepData(**_arrays(StepData, "kept", arrays))
        kept = Kept(data, arrays["kept.y"], bool(words["kept"]))
    continuation = Continuation(
        Origin(jnp.asarray(arrays["cells"]), jnp.asarray(arrays["x0"]), parameters, settings),
        History(**_arrays(History, "history", arrays)),
        **dict(zip(_NUMBERS, arrays["numbers"].tolist(), strict=True)),
        rejections=words["rejections"],
        kept=kept,
    )
    new_meshes = tuple(
        NewMesh(
            said["step"],
            said["t"],
            meshes[said["mesh"]],
            **{name: jnp.asarray(arrays[f"new_meshes.{k}.{name}"]) for name in _MAP},
            changes=said["changes"],
        )
        for k, said in enumerate(words["new_meshes"])
    )
    solution = Solution(
        tuple(states[1:]),
        states[0],
        tuple(arrays["times"].tolist()),
        tuple(records),
        result_named(words["result"]),
        words["stats"],
        continuation,
        new_meshes,
    )
    check_whole(solution)
    return solution


def _fields(prefix: str, module) -> dict[str, Any]:
    return {f"{prefix}.{f.name}": getattr(module, f.name) for f in dataclasses.fields(module)}


def _arrays(kind, prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    return {f.name: jnp.asarray(arrays[f"{prefix}.{f.name}"]) for f in dataclasses.fields(kind)}

"""Whether the parts of a solution fit together, and fit the flow that is to go on with it."""

from typing import Any

import numpy as np

from ..flows import System
from ._continuation import Continuation
from ._solution import Solution


def check_whole(solution: Solution) -> None:
    """Complain about a solution that no run can have left.

    **Raises:** `ValueError` saying which part does not fit.
    """
    n, c = solution.mesh.n_nodes, solution.continuation
    for k, new in enumerate(solution.new_meshes):
        _has(f"weights of the new mesh {k}", new.weights, (n, solution.mesh.cells.shape[1]))
        _has(f"offset of the new mesh {k}", new.offset, (n, 3))
        nodes = np.asarray(new.nodes)
        if nodes.shape != new.weights.shape or nodes.min() < 0 or nodes.max() >= n:
            raise ValueError(f"the new mesh {k} comes from nodes that are not there")
    for k, state in enumerate((solution.state, *solution.saved)):
        name = "the state" if k == 0 else f"the saved state {k - 1}"
        _has(f"x of {name}", state.x, (n, 3))
        for field, values in state.fields.items():
            _has(f"{field} of {name}", values, (n, *values.shape[1:]))
    _has("x0", c.origin.x0, (n, 3))
    depth, width = c.history.times.shape[0], c.history.U.shape[-1]
    conserved, n_globals = c.history.amounts.shape[-1], c.history.multipliers.shape[-1]
    _check_history(c, n, (depth, width, conserved, n_globals))
    if c.kept is not None:
        _check_kept(c, n, (width, conserved, n_globals))
    if not (c.dt > 0 and np.isfinite(c.dt)):
        raise ValueError(f"its next step is {c.dt}")
    steps, counts = solution.stats.get("steps"), (len(solution.records), len(solution.times) - 1)
    if counts != (steps, steps):
        raise ValueError(
            f"it counts {steps} steps, and its history has {counts[0]} of them and "
            f"{len(solution.times)} times"
        )
    if solution.times[-1] != solution.state.t:
        raise ValueError(f"it is at t = {solution.state.t}, its history at {solution.times[-1]}")


def check_fits(c: Continuation, flow: System, depth: int) -> None:
    """Complain about a history of other fields than those of a flow.

    **Raises:** `ValueError`.
    """
    found = (c.history.times.shape[0], c.history.U.shape[-1])
    found += c.history.amounts.shape[-1], c.history.multipliers.shape[-1]
    wanted = depth, flow.layout.width, len(flow.conserved), flow.n_globals
    if found != wanted:
        raise ValueError(
            "`resume` holds a history with (states, columns, conserved fields, global unknowns) = "
            f"{found}; this flow has {wanted}. Start a new run from the nodes `resume.state.x`."
        )


def _check_history(c: Continuation, n: int, counts: tuple[int, int, int, int]) -> None:
    depth, width, conserved, n_globals = counts
    shapes = {
        "times": (depth,),
        "x": (depth, n, 3),
        "U": (depth, n, width),
        "amounts": (depth, n, conserved),
        "multipliers": (depth, n_globals),
    }
    for name, shape in shapes.items():
        _has(f"{name} of the history", getattr(c.history, name), shape)


def _check_kept(c: Continuation, n: int, counts: tuple[int, int, int]) -> None:
    assert c.kept is not None
    width, conserved, n_globals = counts
    data, y = c.kept.data, c.kept.y
    shapes = {
        **{"t": (), "c0": (), "length": ()},
        **{"x_memory": (n, 3), "x_hat": (n, 3), "memory": (n, width), "hat": (n, width)},
        **{"amounts": (n, conserved), "data": (n, data.data.shape[-1])},
    }
    for name, shape in shapes.items():
        _has(f"{name} of the Jacobian", getattr(data, name), shape)
    _has("the unknowns of the Jacobian", y, (n * width + n_globals,))


def _has(name: str, array: Any, shape: tuple[int, ...]) -> None:
    if tuple(array.shape) != shape:
        raise ValueError(f"{name} has shape {tuple(array.shape)}, not {shape}")
    if np.asarray(array).dtype != np.float64:
        raise ValueError(f"{name} is of {np.asarray(array).dtype}, not of float64")

"""What a run needs beside its last state to go on as if it had not stopped."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..flows import System
from ..mesh import SurfaceMesh
from ._step import StepData
from ._stepper import History


class Kept(eqx.Module):
    """Where the Jacobian was assembled that a run keeps from step to step.

    Its factors decide the last digits of the steps to come, and are many times larger than this,
    from which the same ones are made again.

    **Attributes:**

    - `data`, `y`: the step, and the unknowns in it.
    - `is_whole`: whether the whole matrix was factorised, beside the preconditioner.
    """

    data: StepData
    y: Float[Array | np.ndarray, " unknowns"]
    is_whole: bool


class Origin(eqx.Module):
    """What a run began with, by which another call knows that it goes on with the same one.

    **Attributes:**

    - `cells`, `x0`: the mesh and its nodes.
    - `parameters`: all numbers and arrays in the flow.
    - `settings`: arguments of `evolve` that decide its steps, by name.
    """

    cells: Int[Array | np.ndarray, "cells local"]
    x0: Float[Array | np.ndarray, "nodes 3"]
    parameters: tuple[np.ndarray, ...]
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def check(self, now: "Origin") -> None:
        """Complain about a run that is to go on with something else.

        Nodes and parameters may differ by rounding, as they do on another machine.

        **Raises:** `ValueError` naming what differs.
        """
        mine, other = dict(self.settings), dict(now.settings)
        for name in other:
            if mine.get(name) != other[name]:
                what = f"`{name}` = {mine.get(name)!r}; got {other[name]!r}"
                raise ValueError(f"`resume` holds a run with {what}. {_ADVICE}")
        if not np.array_equal(self.cells, now.cells):
            raise ValueError("`resume` holds a run on another mesh.")
        if not _near(self.x0, now.x0):
            raise ValueError(f"`resume` holds a run from other nodes than `x0`. {_ADVICE}")
        if not _all_near(self.parameters, now.parameters):
            raise ValueError(f"`resume` holds a run of a flow with other parameters. {_ADVICE}")


_ADVICE = (
    "A run goes on with what it began with; to change that, start a new run from the nodes "
    "`resume.state.x`."
)


def origin_of(flow: System, mesh: SurfaceMesh, x0, settings: dict[str, Any]) -> Origin:
    """The origin of a run that starts now."""
    names = {"fields": list(flow.layout.names), "global unknowns": list(flow.global_names)}
    return Origin(mesh.cells, x0, parameters_of(flow), tuple((names | settings).items()))


def parameters_of(flow: System) -> tuple[np.ndarray, ...]:
    """All numbers and arrays in a flow; functions are not compared."""
    leaves = jax.tree.leaves(eqx.filter(flow, eqx.is_array_like))
    return tuple(np.asarray(leaf, float) for leaf in leaves)


def _near(a, b) -> bool:
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape:
        return False
    size = np.max(np.abs(a), initial=0.0)
    return bool(np.allclose(a, b, rtol=1e-9, atol=1e-9 * size, equal_nan=True))


def _all_near(some, others) -> bool:
    return len(some) == len(others) and all(map(_near, some, others))


class Continuation(eqx.Module):
    """All that decides the steps to come, to the last bit.

    **Attributes:**

    - `origin`: what the run began with.
    - `history`: the states that the next step is made from.
    - `dt`: the next step.
    - `energy`, `size`, `floor`, `least`: of the last state and of the energy guard.
    - `rejections`: of the next step so far.
    - `kept`: the Jacobian, if there is one.
    """

    origin: Origin
    history: History
    dt: float
    energy: float
    size: float
    floor: float
    least: float
    rejections: int
    kept: Kept | None

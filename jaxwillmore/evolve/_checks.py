"""Arguments of runs, refused before anything is computed. Traced values of `replay` pass."""

import math
import numbers
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._arguments import double, not_traced
from ..flows import AbstractLaw, System, as_system
from ..mesh import SurfaceMesh
from ._continuation import Origin
from ._remeshing import NewMesh, Remeshing
from ._solution import Solution


def checked_known(**values: Any) -> None:
    """What `evolve` is given, which works outside of compiled functions only."""
    instead = "Choose the times outside and pass them to `replay`, which can be differentiated."
    not_traced("evolve", instead, **values)


def checked_flow(flow, mesh) -> System:
    """The system of a flow: of a law, or as it is; a mesh beside it, and not their classes."""
    kinds = (("flow", flow, AbstractLaw | System), ("mesh", mesh, SurfaceMesh))
    for name, value, kind in kinds:
        if isinstance(value, type):
            raise ValueError(
                f"`{name}` must be an instance; got the class {value.__name__}. "
                f"Write `{value.__name__}(...)`."
            )
        if not isinstance(value, kind):
            hint = " Generators return `(mesh, x)`." if isinstance(value, tuple) else ""
            wanted = "a law or a `System`" if name == "flow" else "of type SurfaceMesh"
            raise ValueError(f"`{name}` must be {wanted}; got {type(value).__name__}.{hint}")
    return as_system(flow)


def _is_finite(value) -> bool:
    """Whether a value of any type is one finite real number."""
    host = np.asarray(value)
    return host.shape == () and host.dtype.kind in "iuf" and math.isfinite(host)


def checked_interval(t0: Any, t1: Any, dt0: Any, rtol: Any, max_steps: Any) -> None:
    """Times, the error tolerance and the step limit of a run."""
    for name, value in (("t0", t0), ("t1", t1)):
        if not _is_finite(value):
            raise ValueError(f"`{name}` must be a finite number; got {value!r}.")
    if not t1 > t0:
        raise ValueError(f"`t1` must be larger than `t0`; got t0 = {t0}, t1 = {t1}.")
    if dt0 is not None and not (_is_finite(dt0) and 0 < dt0 <= t1 - t0):
        raise ValueError(f"`dt0` must be positive and at most t1 - t0 = {t1 - t0}; got {dt0!r}.")
    if rtol is not None and not (_is_finite(rtol) and 0 < rtol < 1):
        raise ValueError(
            f"`rtol` must lie between 0 and 1, or be None (fixed steps); got {rtol!r}."
        )
    if not isinstance(max_steps, numbers.Integral) or max_steps < 1:
        raise ValueError(f"`max_steps` must be an integer and at least 1; got {max_steps!r}.")


def checked_tolerances(**tolerances: Any) -> None:
    """Tolerances that are positive, or None where that is offered."""
    for name, value in tolerances.items():
        offered = name != "newton_tolerance"
        if value is None and offered:
            continue
        if value is None or not (_is_finite(value) and value > 0):
            also = ", or None" if offered else ""
            raise ValueError(f"`{name}` must be a positive number{also}; got {value!r}.")


def checked_order(bdf_order) -> None:
    """An order that BDF is stable for."""
    if not isinstance(bdf_order, numbers.Integral) or bdf_order not in (1, 2, 3, 4, 5):
        raise ValueError(f"`bdf_order` must be 1, 2, 3, 4 or 5; got {bdf_order!r}.")


def checked_nodes(mesh: SurfaceMesh, x0) -> Float[Array, "nodes 3"]:
    """Nodes as an array of 64-bit floats of the right shape, finite."""
    return _checked_field("x0", x0, (mesh.n_nodes, 3))


def checked_fields(flow: System, mesh: SurfaceMesh, initial) -> dict[str, Array]:
    """Initial fields by name, each of its shape, finite."""
    out = {}
    for name, value in ({} if initial is None else initial).items():
        if name not in flow.evolving:
            raise ValueError(f"`initial` may give {flow.evolving}; got {name!r}.")
        columns = flow.layout.columns(name)
        size = columns.stop - columns.start
        shape = (mesh.n_nodes,) if size == 1 else (mesh.n_nodes, size)
        out[name] = _checked_field(f"initial[{name!r}]", value, shape)
    return out


def _checked_field(name: str, value, shape: tuple[int, ...]) -> Array:
    value = double(name, value)
    if value.shape != shape:
        raise ValueError(f"`{name}` must have shape {shape}; got {value.shape}.")
    if isinstance(value, Tracer):
        return value
    finite = np.isfinite(np.asarray(value)).reshape(shape[0], -1).all(axis=1)
    if not finite.all():
        lost = np.flatnonzero(~finite)[:10].tolist()
        raise ValueError(f"`{name}` must be finite; at nodes {lost} it is not.")
    return value


def checked_schedule(times) -> Float[Array, " times"]:
    """The times of a replay: at least two, rising."""
    times = jnp.asarray(times, float)
    if times.ndim != 1 or times.shape[0] < 2:
        raise ValueError(f"`times` needs at least two increasing times; got shape {times.shape}.")
    if not isinstance(times, Tracer):
        steps = np.diff(np.asarray(times))
        if not np.all(steps > 0) or not np.all(np.isfinite(steps)):
            k = int(np.argmin((steps > 0) & np.isfinite(steps)))
            raise ValueError(
                f"`times` must be finite and increase; got {times[k]} before {times[k + 1]}."
            )
    return times


def checked_remeshing(remesh: Any, flow: System) -> None:
    """Settings of new meshes, for a flow that can have some."""
    if remesh is None:
        return
    if not isinstance(remesh, Remeshing):
        raise ValueError(
            f"`remesh` must be a `Remeshing`, or None; got {type(remesh).__name__}. Write "
            "`remesh=jw.evolve.Remeshing(least_angle=15.0)`."
        )
    _check_remeshable(flow)


def _check_remeshable(flow: System) -> None:
    """A surface that moves by its unknowns, with nothing on its nodes but these."""
    if not flow.moves:
        raise ValueError(
            "New meshes are for surfaces that move by their energy; this one is at rest, or its "
            "nodes have a given path."
        )
    fixed = [name for name in flow.carried if name not in flow.layout.names]
    if fixed:
        raise ValueError(
            f"A new mesh needs {', '.join(f'`{name}`' for name in fixed)} to be a field that comes "
            "along to the new nodes; add `MinimalDeformation()` to the system, with which it is, "
            "or give one number for all nodes."
        )


def checked_new_meshes(
    new_meshes: Sequence[NewMesh], mesh: SurfaceMesh, n_steps: int, flow: System
) -> None:
    """New meshes of a run with so many steps that began on `mesh`."""
    steps = [new.step for new in new_meshes]
    if any(b <= a for a, b in zip([0, *steps], [*steps, n_steps + 1], strict=True)):
        raise ValueError(
            f"`new_meshes` belong to the steps {steps}, and `times` has {n_steps} steps; give "
            "those and the `times` of one solution, in order."
        )
    counts = {new.mesh.n_nodes for new in new_meshes} | {
        int(new.nodes.max()) + 1 for new in new_meshes
    }
    if counts != {mesh.n_nodes}:
        raise ValueError(
            f"`new_meshes` belong to meshes of {sorted(counts)} nodes; this one has {mesh.n_nodes}."
        )
    _check_remeshable(flow)


def checked_resume(resume: Solution, now: Origin, t1: float) -> Origin:
    """The origin of a run that goes on; it must be that of the arguments."""
    if not isinstance(resume, Solution):
        raise ValueError(f"`resume` must be a `Solution`; got {type(resume).__name__}.")
    origin = resume.continuation.origin
    origin.check(now)
    if resume.state.t > t1:
        raise ValueError(f"`resume` holds a run that is at t = {resume.state.t}, past t1 = {t1}.")
    return origin

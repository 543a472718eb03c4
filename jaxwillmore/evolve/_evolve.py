"""evolve: run a flow in time with adaptive implicit steps."""

import math
import warnings
from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..flows import AbstractFlow
from ..mesh import SurfaceMesh
from ..surface import area_radius
from ._adaptive import Controller, graded_times, growth_limit
from ._interrupt import catch_interrupts
from ._loop import Loop
from ._save import Saver, save_times
from ._solution import Solution, State, message, name_of
from ._stepper import Stepper


def _checked_times(t0, t1, dt0, rtol, max_steps):
    for name, value in (("t0", t0), ("t1", t1)):
        if not math.isfinite(value):
            raise ValueError(f"`{name}` must be finite; got {value}.")
    if not t1 > t0:
        raise ValueError(f"`t1` must be larger than `t0`; got t0 = {t0}, t1 = {t1}.")
    if dt0 is not None and not (math.isfinite(dt0) and 0 < dt0 <= t1 - t0):
        raise ValueError(f"`dt0` must be positive and at most t1 - t0 = {t1 - t0}; got {dt0}.")
    if rtol is not None and not (math.isfinite(rtol) and 0 < rtol < 1):
        raise ValueError(f"`rtol` must lie between 0 and 1, or be None (fixed steps); got {rtol}.")
    if max_steps < 1:
        raise ValueError(f"`max_steps` must be at least 1; got {max_steps}.")


def evolve(
    flow: AbstractFlow,
    mesh: SurfaceMesh,
    x0: Float[Array, "nodes 3"],
    *,
    t1: float,
    t0: float = 0.0,
    dt0: float | None = None,
    initial: dict[str, Array] | None = None,
    bdf_order: int = 2,
    scheme: str = "implicit",
    rtol: float | None = 1e-3,
    stationary_tolerance: float | None = None,
    saveat: float | Sequence[float] | None = None,
    max_steps: int = 10_000,
    throw: bool = True,
    observer: Callable[[dict[str, float | int], State], None] | None = None,
    on_save: Callable[[State], None] | None = None,
    energy_tolerance: float | None = 1e-5,
    newton_tolerance: float = 1e-8,
    linear_solver: str = "krylov",
) -> Solution:
    r"""Run a flow from `t0` to `t1` with implicit steps of variable size.

    Steps are accepted when the nonlinear solve converged, no triangle turned over, the energy of
    the nodes did not rise, and the local error estimate is below `rtol`; otherwise they are
    repeated with a smaller step. A run that cannot go on keeps its last good state and says why.

    **Arguments:**

    - `flow`, `mesh`, `x0`: the law and the surface it moves.
    - `t0`, `t1`: the interval, in the units of the law (Willmore: length⁴/energy).
    - `dt0`: first step; by default 1e-5 of the flow's time scale at the size of the surface.
    - `initial`: initial fields that a formula is known for, by name (`{"H": ..., "nu": ...}`);
      what is not given is recovered from the nodes.
    - `bdf_order`: 1 to 5. Order 5 is fragile with few steps and warns.
    - `scheme`: `"implicit"` or `"linearly-implicit"`.
    - `rtol`: tolerance of the local error relative to the extent of the surface; `None` takes
      fixed steps `dt0` with a graded start that keeps the order.
    - `stationary_tolerance`: stop when `max|V|` is below this multiple of the velocity scale of
      the law; `None` runs to `t1`.
    - `saveat`: interval between, or list of, times at which states are saved; the states are
      interpolated to the order of the scheme and steps are not shortened for them.
    - `throw`: raise `RuntimeError` when the run stops before `t1` without being stationary.
    - `observer`: called with the diagnostics and the state after every accepted step.
    - `on_save`: called with every saved state as soon as it exists.
    - `energy_tolerance`: relative rise of the energy per step that rejects it; `None` accepts any
      (needed with a `forcing` that does work).

    **Returns:**

    A `Solution`. To differentiate a run, pass its `times` to `replay`.

    **Raises:** `ValueError` for arguments out of range; `RuntimeError` as said under `throw`.

    ```python
    mesh, x = jw.mesh.red_cell(level=1, degree=2)
    solution = jw.evolve.evolve(jw.flows.WillmoreFlow(), mesh, x, t1=1.0)
    ```
    """
    _checked_times(t0, t1, dt0, rtol, max_steps)
    if bdf_order not in (1, 2, 3, 4, 5):
        raise ValueError(f"`bdf_order` must be 1, 2, 3, 4 or 5; got {bdf_order!r}.")
    if bdf_order == 5:
        warnings.warn("BDF5 is unreliable with few or uneven steps; prefer order 2.", stacklevel=2)
    x0 = _checked_nodes(mesh, x0)
    times = save_times(saveat, t0, t1)
    stepper = Stepper(
        flow, mesh, scheme=scheme, newton_tolerance=newton_tolerance, linear_solver=linear_solver
    )
    time_scale = float(flow.time_scale(area_radius(mesh, x0)))
    if dt0 is None:
        dt0 = min(1e-5 * time_scale, t1 - t0)
    loop = Loop(
        stepper,
        controller=Controller(
            rtol=math.inf if rtol is None else rtol,
            growth=growth_limit(bdf_order),
            energy_tolerance=math.inf if energy_tolerance is None else energy_tolerance,
        ),
        schedule=graded_times(t0, t1, dt0, bdf_order, time_scale) if rtol is None else None,
        order=bdf_order,
        stationary_tolerance=stationary_tolerance,
        max_steps=max_steps,
        saver=Saver(stepper, times, bdf_order),
        observer=observer,
        on_save=on_save,
    )
    fields = flow.initial_fields(mesh, x0, {} if initial is None else initial)
    with catch_interrupts() as interrupted:
        solution = loop.run(x0, fields, t0, t1, dt0, interrupted)
    if throw and not solution.succeeded:
        raise RuntimeError(
            f"The run stopped at t = {solution.state.t:.6g} of {t1:.6g} "
            f"({name_of(solution.result)}): {message(solution.result)}"
        )
    return solution


def _checked_nodes(mesh: SurfaceMesh, x0) -> Float[Array, "nodes 3"]:
    x0 = jnp.asarray(x0)
    if x0.dtype != jnp.float64:
        raise ValueError(
            f"`x0` must hold 64-bit floats; got {x0.dtype}. JAX may run with "
            "`jax_enable_x64` off: import jaxwillmore before other code makes arrays."
        )
    if x0.shape != (mesh.n_nodes, 3):
        raise ValueError(f"`x0` must have shape ({mesh.n_nodes}, 3); got {x0.shape}.")
    finite = jnp.all(jnp.isfinite(x0), axis=1)
    if not bool(jnp.all(finite)):
        lost = jnp.flatnonzero(~finite)[:10].tolist()
        raise ValueError(f"`x0` must be finite; nodes {lost} are not.")
    return x0

"""evolve: run a flow in time with adaptive implicit steps."""

import contextlib
import math
import warnings
from collections.abc import Callable, Iterator, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._interrupts import catch_interrupts
from .._machine import checked_memory
from ..flows import AbstractLaw, System
from ..mesh import SurfaceMesh
from ..surface import area_radius
from ._adaptive import Controller, graded_times, growth_limit
from ._checkpoints import Checkpoints
from ._checks import (
    checked_fields,
    checked_flow,
    checked_interval,
    checked_known,
    checked_nodes,
    checked_order,
    checked_remeshing,
    checked_resume,
    checked_tolerances,
)
from ._continuation import origin_of
from ._host_step import HostStep
from ._loop import Loop
from ._memory import memory_estimate
from ._progress import TextProgressMeter, progress_text
from ._remeshing import Remeshing, as_words
from ._save import Saver, save_times
from ._solution import RESULTS, Solution, State, message, name_of
from ._stepper import Stepper


def evolve(
    flow: System | AbstractLaw,
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
    self_contact: bool = False,
    saveat: float | Sequence[float] | None = None,
    max_steps: int = 10_000,
    throw: bool = True,
    observer: Callable[[dict[str, float | int], State], object] | None = None,
    on_save: Callable[[State], None] | None = None,
    energy_tolerance: float | None = 1e-5,
    newton_tolerance: float | None = None,
    linear_solver: str = "krylov",
    progress_meter: TextProgressMeter | None = None,
    remesh: Remeshing | None = None,
    resume: Solution | None = None,
    checkpoints: Checkpoints | None = None,
) -> Solution:
    r"""Run a flow from `t0` to `t1` with implicit steps of variable size.

    Steps are accepted when the nonlinear solve converged, no triangle turned over, the normal
    field kept its length, the energy of the nodes did not rise, and the local error estimate is
    below `rtol`; otherwise they are repeated with a smaller step. A run that cannot go on keeps its
    last good state and says why. Where the flow itself ends, because the surface vanishes, pinches
    off or touches itself, the result says so, and `stats["singular_time"]` is the time.

    **Arguments:**

    - `flow`, `mesh`, `x0`: a law, or a `System` of laws, and the surface it moves.
    - `t0`, `t1`: the interval, in the units of the law (Willmore: length⁴/energy).
    - `dt0`: first step; by default 1e-5 of the flow's time scale at the size of the surface.
    - `initial`: initial fields that a formula is known for, by name (`{"H": ..., "nu": ...}`);
      what is not given is recovered from the nodes.
    - `bdf_order`: 1 to 5. Order 5 is fragile with few steps and warns.
    - `scheme`: `"implicit"` or `"linearly-implicit"`, one linear solve per step: of order 1.5 only
      while H and ν come to rest on the start.
    - `rtol`: tolerance of the local error, of the nodes relative to the extent of the surface, and
      of a concentration with the weight 0.05; `None` takes fixed steps `dt0` with a graded start
      that keeps the order.
    - `stationary_tolerance`: stop when `max|V|` is below this multiple of the velocity scale of
      the law, and the flux of a concentration below that of its scale; `None` runs to `t1`.
    - `self_contact`: stop where triangles of the surface pierce each other, which is looked for
      after every step.
    - `saveat`: interval between, or list of, times at which states are saved; the states are
      interpolated to the order of the scheme and steps are not shortened for them.
    - `throw`: raise `RuntimeError` when the run stops before `t1` without being stationary.
    - `observer`: called with the diagnostics and the state after every accepted step. Where it
      returns `True` the run ends there, complete, with the result `stopped`, which is no error;
      every other answer is ignored. An exception ends it too, and reaches the caller.
    - `on_save`: called with every saved state as soon as it exists.
    - `energy_tolerance`: rise of the energy per step that rejects it, relative to the sum of the
      sizes of its terms (`energy_scale` of the flow); `None` accepts any, as it is for flows in
      which a law does work (`lowers_energy` of the flow is false).
    - `newton_tolerance`: error of the unknowns of a step, field by field relative to the larger of
      its typical and its largest value; by default a hundredth of `rtol`, and a tenth of
      `stationary_tolerance` where that is less (1e-8 for fixed steps). Area, volume and amounts
      that are held are so to rounding, whatever it is.
    - `linear_solver`: `"krylov"` (falls back to LU where it stalls), `"direct"`, `"dense"` (up to
      2,500 unknowns), or `"pardiso"` with the extra `fast`.
    - `progress_meter`: a `TextProgressMeter` that shows the last step; `None` is silent.
    - `remesh`: when to go on with a new mesh (`Remeshing`); `None` keeps the mesh. States know
      their meshes, `Solution.new_meshes` how the nodes of one come from those of the other, and
      what changed by that. Area, volume and amounts stay.
    - `resume`: the solution of a run that ended early, or one that `checkpoints` handed out. The
      run goes on from its last state as if it had not stopped, to the last bit on the same machine.
      All other arguments are given as before; only `t1` (unless steps are fixed), `saveat` and
      `max_steps` may become larger, and times of `saveat` that are past are left out.
    - `checkpoints`: hands out the run so far, now and then.

    **Returns:**

    A `Solution`. To differentiate a run, pass its `times` to `replay`.

    **Raises:** `ValueError` for arguments out of range, for traced ones (`replay` takes these), for
    others than those of the run to resume, and for a run that needs more memory than the machine
    has (`memory_estimate`); `RuntimeError` as said under `throw`.

    ```python
    mesh, x = jw.mesh.red_cell(level=1, degree=2)
    solution = jw.evolve.evolve(jw.flows.WillmoreFlow(), mesh, x, t1=1.0)
    ```
    """
    flow = checked_flow(flow, mesh)
    # The flow last: one that is made inside a compiled function is traced with everything else.
    checked_known(x0=x0, t0=t0, t1=t1, dt0=dt0, initial=initial, saveat=saveat, flow=flow)
    checked_interval(t0, t1, dt0, rtol, max_steps)
    checked_tolerances(
        stationary_tolerance=stationary_tolerance,
        energy_tolerance=energy_tolerance,
    )
    if newton_tolerance is None:
        newton_tolerance = _newton_tolerance(rtol, stationary_tolerance)
    checked_tolerances(newton_tolerance=newton_tolerance)
    checked_order(bdf_order)
    if bdf_order == 5:
        warnings.warn("BDF5 is unreliable with few or uneven steps; prefer order 2.", stacklevel=2)
    x0 = checked_nodes(mesh, x0)
    checked_remeshing(remesh, flow)
    settings = {
        "t0": t0,
        # Fixed steps divide the whole interval.
        "t1": t1 if rtol is None else None,
        "dt0": dt0,
        "bdf_order": bdf_order,
        "scheme": scheme,
        "rtol": rtol,
        "stationary_tolerance": stationary_tolerance,
        "self_contact": self_contact,
        "energy_tolerance": energy_tolerance,
        "newton_tolerance": newton_tolerance,
        "linear_solver": linear_solver,
        **as_words(remesh),
    }
    origin = origin_of(flow, mesh, x0, settings)
    if resume is not None:
        origin = checked_resume(resume, origin, t1)
        x0 = jnp.asarray(origin.x0)
    given = checked_fields(flow, mesh, initial)
    times = save_times(saveat, t0, t1)
    checked_memory(
        memory_estimate(flow, mesh, linear_solver=linear_solver),
        f"A run of {flow.layout.width} fields on {mesh.n_nodes:,} nodes",
    )
    stepper = Stepper(
        flow, mesh, scheme=scheme, newton_tolerance=newton_tolerance, linear_solver=linear_solver
    )
    time_scale = float(flow.units(area_radius(mesh, x0)).time)
    usual = min(1e-5 * time_scale, t1 - t0)
    dt0 = usual if dt0 is None else dt0
    loop = Loop(
        stepper,
        advance_with=lambda stepper: _advance(stepper, newton_tolerance),
        controller=Controller(
            rtol=math.inf if rtol is None else rtol,
            growth=growth_limit(bdf_order),
            smallest=1e-6 * min(dt0, usual),
            energy_tolerance=_energy_tolerance(flow, energy_tolerance),
        ),
        schedule=graded_times(t0, t1, dt0, bdf_order, time_scale) if rtol is None else None,
        order=bdf_order,
        stationary_tolerance=stationary_tolerance,
        self_contact=self_contact,
        max_steps=max_steps,
        saver=Saver(times, bdf_order),
        remeshing=remesh,
        observer=_observers(observer, progress_meter, t1),
        on_save=on_save,
        checkpoints=checkpoints,
        origin=origin,
    )
    with _shown(progress_meter), catch_interrupts() as interrupted:
        if resume is None:
            fields = flow.start(mesh, x0, given)
            solution = loop.run(x0, fields, t0, t1, dt0, interrupted)
        else:
            solution = loop.resume(resume, t1, interrupted)
    if throw:
        _raise_failure(solution, t1)
    return solution


@contextlib.contextmanager
def _shown(meter: TextProgressMeter | None) -> Iterator[None]:
    """Show the meter while a run goes on."""
    if meter is None:
        yield
        return
    meter.start()
    try:
        yield
    finally:
        meter.close()


def _raise_failure(solution: Solution, t1: float) -> None:
    if not (solution.succeeded or bool(solution.result == RESULTS.stopped)):
        raise RuntimeError(
            f"The run stopped at t = {solution.state.t:.6g} of {t1:.6g} "
            f"({name_of(solution.result)}): {message(solution.result)}"
        )


def _newton_tolerance(rtol: float | None, stationary_tolerance: float | None) -> float:
    if rtol is None:
        return 1e-8
    # A velocity below the tolerance of the solve says nothing about rest.
    return min(
        0.01 * rtol, math.inf if stationary_tolerance is None else 0.1 * stationary_tolerance
    )


def _advance(stepper: Stepper, tolerance: float):
    """What attempts a step: Newton from the host, or the traced stages of the linear scheme."""
    if stepper.scheme == "implicit":
        return HostStep(stepper, tolerance)
    return lambda history, w, t: _linear_step(stepper, history, w, t)


@eqx.filter_jit
def _linear_step(stepper: Stepper, history, w, t):
    return stepper(history, w, t)


def _energy_tolerance(flow: System, tolerance: float | None) -> float:
    return math.inf if tolerance is None or not flow.lowers_energy else tolerance


def _observers(observer, meter: TextProgressMeter | None, t1: float):
    """One function for the user's observer and the progress meter."""
    if meter is None:
        return observer

    def both(record, state):
        meter.update(progress_text(record, t1))
        return None if observer is None else observer(record, state)

    return both

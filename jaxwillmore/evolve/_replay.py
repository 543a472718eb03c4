"""replay: a run on a given schedule of times, differentiable in everything."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from ..flows import AbstractLaw, System
from ..mesh import SurfaceMesh
from ._checks import (
    checked_fields,
    checked_flow,
    checked_new_meshes,
    checked_nodes,
    checked_order,
    checked_schedule,
)
from ._remeshing import NewMesh, history_on
from ._stepper import Stepper, Weights, weights


class Trajectory(eqx.Module):
    """States at all times of a schedule.

    **Attributes:**

    - `times`: the schedule.
    - `x`: nodes at every time, the initial ones first; after a new mesh those of that.
    - `fields`: nodal fields by name at every time but the first.
    - `multipliers`: global unknowns of the flow (tension, pressure, ...) by name, likewise.
    - `converged`: whether every implicit step converged.
    """

    times: Float[Array, " times"]
    x: Float[Array, "times nodes 3"]
    fields: dict[str, Array]
    multipliers: dict[str, Float[Array, " steps"]]
    converged: Array


def _all_weights(times: Float[Array, " times"], depth: int, order: int) -> Weights:
    """Weights of every step of a schedule, stacked."""
    n = times.shape[0] - 1

    def of(k: int) -> Weights:
        known = min(k + 1, depth)
        # Newest first; rows before the start hold distinct times that no formula uses.
        past = times[k::-1][:known] if k >= 0 else times[:1]
        filler = times[0] - 1.0 - jnp.arange(depth - known, dtype=float)
        return weights(jnp.concatenate([past[:known], filler]), times[k + 1], known, order)

    first = [of(k) for k in range(min(n, depth - 1))]
    stacked = [jax.tree.map(lambda a: a[None], w) for w in first]
    if n > depth - 1:
        window = jnp.arange(depth - 1, n)[:, None] - jnp.arange(depth)[None, :]
        stacked.append(
            jax.vmap(lambda past, t: weights(past, t, depth, order))(times[window], times[depth:])
        )
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *stacked)


def _is_a_solution(primitive, *_, **__) -> bool:
    """Whether an operation is a root find: the one thing that is not done again in reverse.

    Optimistix gives its derivative by the implicit function theorem, as a custom rule.
    """
    return primitive.name == "custom_jvp_call"


def replay(
    flow: System | AbstractLaw,
    mesh: SurfaceMesh,
    x0: Float[Array, "nodes 3"],
    times: Float[Array, " times"],
    *,
    initial: dict[str, Array] | None = None,
    bdf_order: int = 2,
    scheme: str = "implicit",
    newton_tolerance: float = 1e-11,
    linear_solver: str = "krylov",
    stepper: Stepper | None = None,
    checkpoint: bool = True,
    new_meshes: Sequence[NewMesh] = (),
) -> Trajectory:
    r"""Run a flow through given times, as one differentiable function.

    Every step is solved implicitly, so its derivative is one solve with the matrix of the step
    (forward mode) or its transpose (reverse mode); no Newton iteration is differentiated. The
    schedule is usually the `times` of a `Solution`; derivatives take it as frozen, except through
    `times` itself, which may be an argument of differentiation.

    **Arguments:**

    - `flow`, `mesh`, `x0`, `initial`, `bdf_order`, `scheme`: as in `evolve`. Flow parameters,
      `x0`, `initial` and `times` may be traced.
    - `times`: increasing, the first one is the time of `x0`.
    - `newton_tolerance`: tighter than for a plain run, because derivatives inherit the error.
    - `linear_solver`: as in `evolve`. `"dense"` solves inside the program: it is the one for many
      parameter sets at once under `vmap`, and for a whole run on a device.
    - `stepper`: a `Stepper` of the same mesh, when `mesh` itself is traced and its sparsity
      cannot be computed; its flow is replaced by `flow`.
    - `new_meshes`: those of the `Solution` whose `times` are given, if its run was remeshed. After
      the step that each belongs to, everything goes on on its nodes; derivatives pass, with which
      old triangle every new node lies in, and where, taken as fixed.
    - `checkpoint`: keep only the solution of every step for the reverse pass, and linearise about
      it there. `False` keeps the linearisations: ten times the memory, and no faster.

    **Raises:** `ValueError` if `times` has fewer than two entries or does not increase, for new
    meshes that do not belong to this mesh and these times, and for the other arguments as `evolve`.

    ```python
    def final_area(b):
        run = jw.evolve.replay(jw.flows.WillmoreFlow(b), mesh, x, solution.times)
        return jw.surface.area(mesh, run.x[-1])

    slope = jax.grad(final_area)(0.5)
    ```
    """
    flow = checked_flow(flow, mesh)
    checked_order(bdf_order)
    times, x0 = checked_schedule(times), checked_nodes(mesh, x0)
    advance = (
        Stepper(
            flow,
            mesh,
            scheme=scheme,
            newton_tolerance=newton_tolerance,
            linear_solver=linear_solver,
        )
        if stepper is None
        else eqx.tree_at(lambda s: s.problem.flow, stepper, flow)
    )
    fields = flow.start(mesh, x0, checked_fields(flow, mesh, initial))
    if new_meshes:
        checked_new_meshes(new_meshes, mesh, times.shape[0] - 1, flow)
        x, U, multipliers, converged = _run_through(
            advance, x0, fields, times, bdf_order, checkpoint, new_meshes
        )
    else:
        x, U, multipliers, converged = _run(advance, x0, fields, times, bdf_order, checkpoint)
    return Trajectory(
        times,
        jnp.concatenate([jnp.asarray(x0)[None], x]),
        flow.layout.split(U, axis=2),
        {name: multipliers[:, k] for k, name in enumerate(flow.global_names)},
        jnp.all(converged),
    )


# Compiled once for a kind of flow, a mesh size and a number of times: parameters, nodes and times
# are arguments, so that a loop over them, or over gradients, compiles in its first round alone.
@eqx.filter_jit
def _run(advance: Stepper, x0, fields, times, bdf_order: int, checkpoint: bool):
    """Nodes, unknowns, multipliers and convergence of every step of a schedule."""
    depth = max(bdf_order + 1, 3)
    history = advance.start(times[0], x0, fields, depth)
    schedule = _all_weights(times, depth, bdf_order), times[1:]
    return jax.lax.scan(_step_of(advance, checkpoint), history, schedule)[1]


def _step_of(advance: Stepper, checkpoint: bool):
    """A step from a history to the next one, with what is kept of it."""

    def step(history, inputs):
        w, t = inputs
        attempt = advance(history, w, t)
        new = history.push(t, attempt.x, attempt.U, attempt.amounts, attempt.multipliers)
        converged = attempt.result == optx.RESULTS.successful
        return new, (attempt.x, attempt.U, attempt.multipliers, converged)

    if checkpoint:
        step = jax.checkpoint(step, policy=_is_a_solution)  # pyright: ignore[reportPrivateImportUsage]
    return step


# One step at a time, since the mesh changes between them; its arrays are arguments of one program.
@eqx.filter_jit
def _one_step(advance: Stepper, history, w, t, checkpoint: bool):
    return _step_of(advance, checkpoint)(history, (w, t))


def _run_through(advance, x0, fields, times, bdf_order: int, checkpoint: bool, new_meshes):
    """As `_run`, through new meshes."""
    depth = max(bdf_order + 1, 3)
    history = advance.start(times[0], x0, fields, depth)
    all_weights, kept = _all_weights(times, depth, bdf_order), []
    after = {new.step: new for new in new_meshes}
    for k in range(times.shape[0] - 1):
        w = jax.tree.map(lambda a, k=k: a[k], all_weights)
        history, state = _one_step(advance, history, w, times[k + 1], checkpoint)
        kept.append(state)
        if k + 1 in after:
            advance = advance.on(after[k + 1].mesh)
            history = history_on(after[k + 1], advance, history)
    return jax.tree.map(lambda *states: jnp.stack(states), *kept)

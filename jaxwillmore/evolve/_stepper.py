"""One attempted step: history, weights, solve, and what a controller needs to judge it."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from ..fem import load, rule_for
from ..flows import SLIP, AbstractLaw, System, Whole, as_system
from ..linalg import SparseNewton, SparseSolver, TangentGroup, block_pattern, checked_method
from ..mesh import SurfaceMesh
from ..surface import area_radius
from ._bdf import bdf, extrapolation, padded
from ._step import ImplicitStep, LinearStage, Problem, StepData

SCHEMES = ("implicit", "linearly-implicit")


class History(eqx.Module):
    r"""The last accepted states, newest first. Rows that are not yet known repeat the first one.

    `amounts` holds the vectors $(c, \chi)_\Gamma$ of the conserved fields, each on its own surface.
    """

    times: Float[Array, " depth"]
    x: Float[Array, "depth nodes 3"]
    U: Float[Array, "depth nodes fields"]
    amounts: Float[Array, "depth nodes conserved"]
    multipliers: Float[Array, "depth globals"]

    def push(self, t, x, U, amounts, multipliers) -> "History":
        """The history after a step; the oldest state leaves."""

        def roll(old, new):
            return jnp.concatenate([jnp.asarray(new)[None], old[:-1]])

        return History(
            roll(self.times, t),
            roll(self.x, x),
            roll(self.U, U),
            roll(self.amounts, amounts),
            roll(self.multipliers, multipliers),
        )


class Weights(eqx.Module):
    """How the states of a history enter a step.

    **Attributes:**

    - `derivative`: BDF weights, first of the new state.
    - `hat`: extrapolation to the new time, of the order of the scheme.
    - `guess`: the start of Newton's iteration.
    - `predictor`: what the new positions are compared with to estimate the local error.
    """

    derivative: Float[Array, " depth_plus_1"]
    hat: Float[Array, " depth"]
    guess: Float[Array, " depth"]
    predictor: Float[Array, " depth"]


def weights(times: Float[Array, " depth"], t: Float[Array, ""], known: int, order: int) -> Weights:
    """Weights of the step to `t` when `known` states exist, at BDF order at most `order`."""
    depth = times.shape[0]
    q = min(known, order)
    # V and z of the initial state are not known: before two solved states the start is the last
    # state itself, with V = z = 0 (a surface at rest) in the very first step.
    start = times[:2] if known > 2 else times[:1]
    return Weights(
        derivative=padded(bdf(times[:q], t), depth + 1),
        hat=padded(extrapolation(times[:q], t), depth),
        guess=padded(extrapolation(start, t), depth),
        predictor=padded(extrapolation(times[: min(known, max(q, 2))], t), depth),
    )


class Attempt(eqx.Module):
    """The outcome of one step, accepted or not."""

    x: Float[Array, "nodes 3"]
    U: Float[Array, "nodes fields"]
    amounts: Float[Array, "nodes conserved"]
    multipliers: Float[Array, " globals"]
    result: optx.RESULTS
    error: Float[Array, ""]
    newton_iterations: Int[Array, ""]
    jacobians: Int[Array, ""]
    linear_iterations: Int[Array, ""]


class Stepper(eqx.Module):
    """A flow on a mesh, ready to step.

    **Arguments:**

    - `flow`, `mesh`: what moves.
    - `scheme`: `"implicit"` (Newton) or `"linearly-implicit"` (coefficients extrapolated, one
      linear solve per stage of the flow).
    - `newton_tolerance`: error of the unknowns, relative to their typical size.
    - `linear_solver`: method of `linalg.SparseSolver`.
    - `max_newton`: iterations before a step is given up.
    """

    problem: Problem
    scheme: str = eqx.field(static=True)
    newton_tolerance: float = eqx.field(static=True)
    method: str = eqx.field(static=True)
    max_newton: int = eqx.field(static=True)

    def __init__(
        self,
        flow: System | AbstractLaw,
        mesh: SurfaceMesh,
        *,
        scheme: str = "implicit",
        newton_tolerance: float = 1e-8,
        linear_solver: str = "krylov",
        max_newton: int = 12,
    ):
        flow = as_system(flow)
        if scheme not in SCHEMES:
            raise ValueError(f"`scheme` must be one of {SCHEMES}; got {scheme!r}.")
        if scheme != "implicit" and flow.n_globals:
            raise ValueError(
                f"The {scheme} scheme has no global unknowns, but the flow has "
                f"{flow.global_names}; use scheme='implicit'."
            )
        if scheme != "implicit" and (flow.implicit_only or not flow.moves):
            raise ValueError(
                f"The {scheme} scheme needs equations that are linear where coefficients are "
                "frozen, on a surface that moves with its unknowns; use scheme='implicit'."
            )
        # Refused here, not in the first step.
        checked_method(linear_solver, mesh.n_nodes * flow.layout.width + flow.n_globals)
        pattern = block_pattern(mesh.cells, mesh.n_nodes)
        self.problem = Problem(flow, mesh, rule_for(mesh), pattern)
        self.scheme, self.newton_tolerance = scheme, newton_tolerance
        self.method, self.max_newton = linear_solver, max_newton

    def on(self, mesh: SurfaceMesh) -> "Stepper":
        """The same on another mesh."""
        return Stepper(
            self.problem.flow,
            mesh,
            scheme=self.scheme,
            newton_tolerance=self.newton_tolerance,
            linear_solver=self.method,
            max_newton=self.max_newton,
        )

    def start(self, t0, x0, fields: dict[str, Array], depth: int) -> History:
        """The history before the first step; fields that are not given are zero."""
        layout = self.problem.flow.layout
        U = jnp.zeros((self.problem.mesh.n_nodes, layout.width))
        for name, value in fields.items():
            columns = layout.columns(name)
            U = U.at[:, columns].set(jnp.reshape(value, (U.shape[0], -1)))

        def repeat(a):
            return jnp.broadcast_to(a, (depth, *jnp.shape(a)))

        # Distinct times keep the unused rows of every formula finite.
        times = t0 - jnp.arange(depth, dtype=float)
        multipliers = jnp.zeros(self.problem.flow.n_globals)
        x0 = jnp.asarray(x0)
        amounts = self.amounts(x0, U)
        return History(times, repeat(x0), repeat(U), repeat(amounts), repeat(multipliers))

    def amounts(self, x, U) -> Float[Array, "nodes conserved"]:
        r"""The vectors $(c, \chi)_\Gamma$ of the conserved fields, by the rule of the weak form."""
        p = self.problem
        columns = [jnp.zeros((p.mesh.n_nodes, 0))]
        for name in p.flow.conserved:
            fields = {"c": U[:, p.flow.layout.columns(name)][:, 0]}
            density = lambda _, f, phi, __: (f.c.value * phi)[None]
            columns.append(load(p.mesh, x, density, fields))
        return jnp.concatenate(columns, axis=1)

    def data(self, history: History, w: Weights, t) -> StepData:
        p = self.problem
        c = w.derivative
        x_hat = jnp.tensordot(w.hat, history.x, axes=1)
        if not p.flow.moves:
            x_hat = p.flow.position(t, history.x[0])
        hat = jnp.tensordot(w.hat, history.U, axes=1)
        length = jax.lax.stop_gradient(area_radius(p.mesh, history.x[0]))
        units, nothing = p.flow.units(length), SimpleNamespace()
        whole = Whole(t, p.mesh, x_hat, self.fields(hat), nothing, units)
        return StepData(
            t=t,
            c0=c[0],
            x_memory=jnp.tensordot(c[1:], history.x, axes=1),
            memory=jnp.tensordot(c[1:], history.U, axes=1),
            amounts=jnp.tensordot(c[1:], history.amounts, axes=1),
            x_hat=x_hat,
            hat=hat,
            data=p.flow.nodal_data(whole),
            length=length,
        )

    def fields(self, U: Float[Array, "nodes fields"]) -> dict[str, Array]:
        """The unknowns by name."""
        return _split(self.problem.flow.layout, U)

    def _solvers(self, groups, linear: bool):
        # The correction of a linear problem is its solution; Newton corrects what is left.
        newton = SparseNewton(
            self.newton_tolerance,
            SparseSolver(groups, 1e-12 if linear else 1e-6, self.method),
            linear=linear,
        )
        return newton, optx.ImplicitAdjoint(SparseSolver(groups, 1e-12, self.method))

    def __call__(self, history: History, w: Weights, t: Float[Array, ""]) -> Attempt:
        """Step from the history to time `t`; differentiable, forward and reverse."""
        data = self.data(history, w, t)
        guess = jnp.tensordot(w.guess, history.U, axes=1)
        if self.scheme == "implicit":
            tail = jnp.tensordot(w.guess, history.multipliers, axes=1)
            x, U, multipliers, result, stats = self._implicit(data, guess, tail)
        else:
            x, U, result, stats = self._linear(data, guess)
            multipliers = history.multipliers[0]
        error = self.local_error(history, w, x, U, data)
        amounts = self.amounts(x, U)
        return Attempt(x, U, amounts, multipliers, result, error, **stats)  # pyright: ignore[reportCallIssue]

    def local_error(self, history: History, w: Weights, x, U, data: StepData):
        """The largest distance from what the history predicts, relative to sizes, over q + 1.

        Of the nodes relative to the extent of the surface, and of every field that is watched
        relative to its scale over its weight.
        """
        flow = self.problem.flow
        order = jnp.sum(jnp.where(w.derivative != 0, 1.0, 0.0)) - 1.0
        worst = jnp.zeros(())
        if flow.moves:
            predicted = jnp.tensordot(w.predictor, history.x, axes=1)
            # Twice the reach from the centre, which does not depend on how the surface is turned.
            reach = history.x[0] - jnp.mean(history.x[0], axis=0)[None, :]
            extent = 2 * jnp.max(jnp.linalg.norm(_safe(reach), axis=1))
            worst = jnp.max(jnp.linalg.norm(_safe(x - predicted), axis=1)) / extent
        units = flow.units(data.length)
        for field in flow.fields:
            if field.error_weight:
                columns = flow.layout.columns(field.name)
                predicted = jnp.tensordot(w.predictor, history.U[:, :, columns], axes=1)
                change = jnp.max(jnp.abs(U[:, columns] - predicted))
                worst = jnp.maximum(worst, field.error_weight * change / field.scale(units))
        finite = jnp.all(jnp.isfinite(x)) & jnp.all(jnp.isfinite(U))
        return jnp.where(finite, worst / (order + 1), jnp.inf)

    def _implicit(self, data, guess, multipliers):
        flow = self.problem.flow
        newton, adjoint = self._solvers(column_groups(flow.layout, flow.stages), False)
        system = ImplicitStep(self.problem, data)
        solution = optx.root_find(
            _residual,
            newton,
            jax.lax.stop_gradient(system.pack(guess, multipliers)),
            system,
            max_steps=self.max_newton,
            adjoint=adjoint,
            throw=False,
        )
        U, multipliers = system.unpack(solution.value)
        return system.positions(U), U, multipliers, solution.result, _stats(solution)

    def _linear(self, data, guess):
        flow = self.problem.flow
        known, result, totals = data.hat, optx.RESULTS.successful, None
        for stage in flow.stages:
            groups = column_groups(flow.layout.restrict(stage), (stage,))
            newton, adjoint = self._solvers(groups, True)
            system = LinearStage(self.problem, data, known, stage)
            solution = optx.root_find(
                _residual,
                newton,
                jax.lax.stop_gradient(system.pack(guess)),
                system,
                max_steps=2,
                adjoint=adjoint,
                throw=False,
            )
            known = system.unpack(solution.value)
            result = optx.RESULTS.where(result == optx.RESULTS.successful, solution.result, result)
            stats = _stats(solution)
            totals = stats if totals is None else jax.tree.map(jnp.add, totals, stats)
        velocity = jax.vmap(lambda u: flow.velocity(SimpleNamespace(**flow.layout.split(u))))(known)
        return (velocity - data.x_memory) / data.c0, known, result, totals


@eqx.filter_jit
def _split(layout, U) -> dict[str, Array]:
    # Compiled as one: on the host every slice would be a program of its own.
    return layout.split(U, axis=1)


def _residual(y, system):
    return system.residual(y)


def _safe(d):
    # The norm has no derivative at zero; the square of what replaces it must not underflow.
    return jnp.where(d == 0, 1e-150, d)


def _stats(solution) -> dict[str, Array]:
    stats = solution.stats
    return {
        "newton_iterations": jnp.asarray(stats["num_steps"]),
        "jacobians": stats["jacobians"],
        "linear_iterations": stats["linear_iterations"],
    }


def column_groups(layout, stages) -> tuple:
    """Groups of columns for the preconditioner: one copy per component of equal-sized fields.

    The tangential velocity and its multiplier are solved in nodal frames.
    """
    groups = []
    for stage in stages:
        spans = [range(*layout.columns(name).indices(layout.width)) for name in stage]
        if stage[0] == SLIP and [len(span) for span in spans] == [3, 1]:
            w1, w2, w3 = spans[0]
            groups.append(TangentGroup((w1, w2, w3), spans[1][0]))
            continue
        if len({len(span) for span in spans}) == 1:
            groups.append(tuple(zip(*spans, strict=True)))
        else:
            groups.append((tuple(column for span in spans for column in span),))
    return tuple(groups)

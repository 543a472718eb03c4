r"""The implicit step driven from the host: Newton around a few compiled functions.

None of the compiled functions calls back into Python, so that JAX can keep them on disk between
processes; assembly, factorisations and solves are plain calls between them. The equations are those
of `ImplicitStep`, which `replay` solves inside one traced program: both agree to Newton's
tolerance.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..fem import HostJacobian, Unsupported, dependence
from ..linalg import HostMatrix, HostNewton, one_blas_thread, solve_on_host
from ._continuation import Kept
from ._step import Assembly, ImplicitStep, StepData
from ._stepper import Attempt, History, Stepper, Weights, column_groups


class HostStep:
    """Attempts the steps of one run; keeps the plan of the Jacobian and the last factors.

    **Arguments:**

    - `stepper`: a flow on a mesh with the implicit scheme.
    - `tolerance`: error of the unknowns of a step, field by field relative to the larger of the
      typical and the largest value.
    """

    def __init__(self, stepper: Stepper, tolerance: float):
        self._stepper = stepper
        self._kept: HostMatrix | None = None
        self._place: tuple[StepData, np.ndarray] | None = None
        self._solver = HostNewton(tolerance, method=stepper.method)
        self._plan: HostJacobian | None = None
        self._has_plan = True

    def __call__(self, history: History, w: Weights, t) -> Attempt:
        """Step from the history to time `t`."""
        data, y = _prepare(self._stepper, history, w, t)
        system = StepOnHost(self, ImplicitStep(self._stepper.problem, data))
        y = np.asarray(y)
        solution = solve_on_host(
            self._solver,
            system,
            y,
            system.residual(y),
            kept=self._kept,
            max_steps=self._stepper.max_newton,
        )
        self._kept = solution.kept
        x, U, amounts, multipliers, error = _finish(
            self._stepper, data, jnp.asarray(solution.y), history, w
        )
        return Attempt(
            x,
            U,
            amounts,
            multipliers,
            solution.result,
            error,
            newton_iterations=jnp.asarray(solution.iterations),
            jacobians=jnp.asarray(solution.jacobians),
            linear_iterations=jnp.asarray(solution.krylov_iterations),
        )

    @property
    def kept(self) -> Kept | None:
        """Where the Jacobian that is kept was assembled."""
        if self._kept is None or not self._kept.alive or self._place is None:
            return None
        return Kept(*self._place, self._kept.is_whole)

    def keep(self, kept: Kept | None) -> None:
        """Assemble and factorise again the Jacobian that was kept, to the last bit."""
        if kept is None:
            return
        system = StepOnHost(self, ImplicitStep(self._stepper.problem, kept.data))
        # The order of sums depends on the number of threads.
        with one_blas_thread():
            blocks, border = system.jacobian(np.asarray(kept.y))
            self._kept = HostMatrix(
                system.pattern, blocks, border, system.groups, self._stepper.method
            )
            if kept.is_whole:
                self._kept.factorise_whole()

    def assembled_at(self, data: StepData, y: np.ndarray) -> None:
        """Remember where the newest Jacobian belongs, which is the one that is kept."""
        self._place = data, y

    def plan(self, a: Assembly) -> HostJacobian | None:
        """How the form is assembled by NumPy; `None` where no plan can be made of it."""
        if self._plan is None and self._has_plan:
            p = self._stepper.problem
            try:
                self._plan = HostJacobian(
                    a.form,
                    np.asarray(p.mesh.cells),
                    p.rule,
                    np.asarray(p.pattern.blocks),
                    p.pattern.n_blocks,
                    a.args,
                    moves=None if a.dx is None else self._moves(),
                )
            except Unsupported:
                self._has_plan = False
        return self._plan

    def _moves(self) -> np.ndarray:
        """Which coordinate of a node depends on which of its unknowns."""
        flow = self._stepper.problem.flow
        return dependence(flow.velocity_of, flow.layout.width)


class StepOnHost:
    """One implicit step as `linalg.solve_on_host` takes it: NumPy in, NumPy out."""

    def __init__(self, owner: HostStep, system: ImplicitStep):
        flow = system.problem.flow
        self._owner, self._system = owner, system
        self.pattern, self.n_globals = system.pattern, system.n_globals
        self.groups = column_groups(flow.layout, flow.stages)
        self.n_fields = flow.layout.width
        self.spans = tuple(flow.layout.columns(name) for name in flow.layout.names)

    def residual(self, y: np.ndarray) -> np.ndarray:
        """F(y)."""
        a = _assembly(self._system, y)
        plan = self._owner.plan(a)
        if plan is None:
            return np.asarray(_residual(self._system, y))
        F = plan.residual(*_fields(a), a.args)
        return np.asarray(_completed(self._system, F, y))

    def jacobian(self, y: np.ndarray) -> tuple[np.ndarray, tuple | None]:
        """The blocks and the border of the derivative of F at y."""
        self._owner.assembled_at(self._system.step, y)
        a = _assembly(self._system, y)
        plan = self._owner.plan(a)
        if plan is None:
            blocks, border = _jacobian(self._system, y)
            return np.asarray(blocks), None if border is None else _on_host(border)
        dx = None if a.dx is None else np.asarray(a.dx)
        blocks = plan(*_fields(a), a.args, dx, np.asarray(a.rows), np.asarray(a.columns))
        if not self.n_globals:
            return blocks, None
        return blocks, (self._by_multipliers(plan, a), *_on_host(_closures(self._system, y)))

    def _by_multipliers(self, plan: HostJacobian, a: Assembly) -> np.ndarray:
        """Derivatives of the nodal equations by the global unknowns.

        By central differences over their typical sizes: exact, since forces add.
        """
        flow, c0, multipliers = a.args
        columns = []
        for k in range(self.n_globals):
            step = np.zeros(self.n_globals)
            step[k] = 0.5 * float(a.global_scales[k])
            ahead, behind = (
                plan.residual(*_fields(a), (flow, c0, np.asarray(multipliers) + sign * step))
                for sign in (1, -1)
            )
            columns.append((ahead - behind) * np.asarray(a.rows))
        return np.stack(columns)


def _on_host(arrays: tuple) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(a) for a in arrays)


def _fields(a: Assembly) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, unknowns and frozen fields."""
    return np.asarray(a.x), np.asarray(a.U), np.asarray(a.Z)


@eqx.filter_jit
def _prepare(stepper: Stepper, history: History, w: Weights, t):
    """The data of a step and the start of Newton's iteration."""
    data = stepper.data(history, w, t)
    guess = jnp.tensordot(w.guess, history.U, axes=1)
    tail = jnp.tensordot(w.guess, history.multipliers, axes=1)
    return data, ImplicitStep(stepper.problem, data).pack(guess, tail)


@eqx.filter_jit
def _residual(system: ImplicitStep, y):
    return system.residual(y)


@eqx.filter_jit
def _completed(system: ImplicitStep, F, y):
    return system.completed(F, y)


@eqx.filter_jit
def _assembly(system: ImplicitStep, y):
    return system.assembly(y)


@eqx.filter_jit
def _closures(system: ImplicitStep, y):
    return system.closure_derivatives(y)


@eqx.filter_jit
def _jacobian(system: ImplicitStep, y):
    operator = system.jacobian(y)
    border = operator.border
    both = (border.columns, border.rows, border.corner) if system.n_globals else None
    return operator.data, both


@eqx.filter_jit
def _finish(stepper: Stepper, data: StepData, y, history: History, w: Weights):
    """What a solved step leaves: nodes, unknowns, amounts, global unknowns, the local error."""
    system = ImplicitStep(stepper.problem, data)
    U, multipliers = system.unpack(y)
    if stepper.problem.flow.conserved:
        U = system.with_exact_amounts(U, multipliers)
    x = system.positions(U)
    error = stepper.local_error(history, w, x, U, data)
    return x, U, stepper.amounts(x, U), multipliers, error

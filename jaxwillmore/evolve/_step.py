"""One time step as a sparse nonlinear system: fully implicit, or linear stage by stage."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Form, Layout, Rule, cell_jacobians, residual
from ..flows import AbstractFlow
from ..linalg import AbstractSparseSystem, BlockPattern, SparseOperator, scatter_blocks
from ..mesh import SurfaceMesh


class Problem(eqx.Module):
    """What stays the same from step to step: flow, mesh, quadrature and sparsity."""

    flow: AbstractFlow
    mesh: SurfaceMesh
    rule: Rule
    pattern: BlockPattern


class StepData(eqx.Module):
    r"""Everything a step takes from the past.

    **Attributes:**

    - `c0`: leading BDF weight $\delta_0/\tau$.
    - `x_memory`, `memory`: the rest of the BDF sum for the nodes and for the unknowns, so that
      $\dot x = c_0 x + x_{memory}$.
    - `x_hat`, `hat`: positions and unknowns extrapolated to the new time.
    - `data`: nodal data of the flow.
    - `length`: the size of the surface, for scaling.
    """

    c0: Float[Array, ""]
    x_memory: Float[Array, "nodes 3"]
    memory: Float[Array, "nodes fields"]
    x_hat: Float[Array, "nodes 3"]
    hat: Float[Array, "nodes fields"]
    data: Float[Array, "nodes data"]
    length: Float[Array, ""]


def _prefixed(prefix: str, layout: Layout) -> Layout:
    return Layout(tuple(prefix + name for name in layout.names), layout.sizes)


def _joined(*layouts: Layout) -> Layout:
    return Layout(
        tuple(name for layout in layouts for name in layout.names),
        tuple(size for layout in layouts for size in layout.sizes),
    )


def _rates(flow, c0, trial, frozen) -> SimpleNamespace:
    return SimpleNamespace(
        **{
            name: c0 * getattr(trial, name).value + getattr(frozen, f"memory_{name}").value
            for name in flow.evolving
        }
    )


def _sum_of_equations(flow, c0, point, hat, trial, frozen, test):
    rate = _rates(flow, c0, trial, frozen)
    return sum(
        flow.equation(name, point, rate, hat, trial, frozen, chi)
        for name, chi in vars(test).items()
    )


def _implicit_integrand(point, trial, frozen, test, args):
    flow, c0 = args
    return _sum_of_equations(flow, c0, point, trial, trial, frozen, test)


def _linear_integrand(point, trial, frozen, test, args):
    flow, c0 = args
    names = flow.layout.names
    hat = SimpleNamespace(**{name: getattr(frozen, f"hat_{name}") for name in names})
    known = {name: getattr(frozen, f"known_{name}") for name in names}
    trial = SimpleNamespace(**{**known, **vars(trial)})
    return _sum_of_equations(flow, c0, point, hat, trial, frozen, test)


def _row_scales(flow: AbstractFlow, mesh: SurfaceMesh, step: StepData) -> Float[Array, " fields"]:
    """Inverse size of every equation: its leading term at the typical size of its unknown."""
    columns = flow.scales(step.length)
    leading = jnp.ones_like(columns)
    for name in flow.evolving:
        leading = leading.at[flow.layout.columns(name)].set(step.c0)
    return mesh.n_nodes / (step.length**2 * leading * columns)


class ImplicitStep(AbstractSparseSystem):
    """The fully implicit step: geometry and coefficients at the new time.

    The unknown is the array of all fields, each divided by its typical size. Positions are not
    unknowns: node by node they follow from the velocity, $x = (v - x_{memory})/c_0$, and the
    Jacobian carries that dependence.
    """

    problem: Problem
    step: StepData

    @property
    def pattern(self):
        return self.problem.pattern

    def positions(self, U: Float[Array, "nodes fields"]) -> Float[Array, "nodes 3"]:
        """Nodes at the new time for the unscaled unknowns `U`."""
        return (jax.vmap(self._velocity)(U) - self.step.x_memory) / self.step.c0

    def _velocity(self, U_j):
        flow = self.problem.flow
        return flow.velocity(SimpleNamespace(**flow.layout.split(U_j)))

    def _form(self):
        flow = self.problem.flow
        frozen = _joined(flow.data, _prefixed("memory_", flow.layout))
        Z = jnp.concatenate([self.step.data, self.step.memory], axis=1)
        return Form(_implicit_integrand, flow.layout, frozen), Z, (flow, self.step.c0)

    def residual(self, y):
        p = self.problem
        form, Z, args = self._form()
        U = y * p.flow.scales(self.step.length)
        F = residual(form, p.mesh, p.rule, self.positions(U), U, Z, args)
        return F * _row_scales(p.flow, p.mesh, self.step)

    def jacobian(self, y):
        p = self.problem
        form, Z, args = self._form()
        columns = p.flow.scales(self.step.length)
        U = y * columns
        dx = jax.vmap(jax.jacfwd(self._velocity))(U) / self.step.c0
        local = cell_jacobians(form, p.mesh, p.rule, self.positions(U), U, Z, args, dx)
        rows = _row_scales(p.flow, p.mesh, self.step)
        return SparseOperator(scatter_blocks(p.pattern, local) * rows[:, None] * columns, p.pattern)


class LinearStage(AbstractSparseSystem):
    """One decoupled linear system of the linearly implicit step.

    Geometry and coefficients are extrapolated; `known` holds the fields that the stage takes as
    given, extrapolated or solved by an earlier stage.
    """

    problem: Problem
    step: StepData
    known: Float[Array, "nodes fields"]
    fields: tuple[str, ...] = eqx.field(static=True)

    @property
    def pattern(self):
        return self.problem.pattern

    def _form(self):
        flow = self.problem.flow
        frozen = _joined(
            flow.data,
            _prefixed("memory_", flow.layout),
            _prefixed("hat_", flow.layout),
            _prefixed("known_", flow.layout),
        )
        Z = jnp.concatenate([self.step.data, self.step.memory, self.step.hat, self.known], axis=1)
        form = Form(_linear_integrand, flow.layout.restrict(self.fields), frozen)
        return form, Z, (flow, self.step.c0)

    def select(self, array, axis=-1):
        """The columns of this stage out of an array of all fields."""
        layout = self.problem.flow.layout
        index = [k for name in self.fields for k in range(*layout.columns(name).indices(99))]
        return jnp.take(array, jnp.asarray(index), axis=axis)

    def residual(self, y):
        p = self.problem
        form, Z, args = self._form()
        U = y * self.select(p.flow.scales(self.step.length))
        F = residual(form, p.mesh, p.rule, self.step.x_hat, U, Z, args)
        return F * self.select(_row_scales(p.flow, p.mesh, self.step))

    def jacobian(self, y):
        p = self.problem
        form, Z, args = self._form()
        columns = self.select(p.flow.scales(self.step.length))
        local = cell_jacobians(form, p.mesh, p.rule, self.step.x_hat, y * columns, Z, args)
        rows = self.select(_row_scales(p.flow, p.mesh, self.step))
        return SparseOperator(scatter_blocks(p.pattern, local) * rows[:, None] * columns, p.pattern)

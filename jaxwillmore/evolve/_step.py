"""One time step as a sparse nonlinear system: fully implicit, or linear stage by stage."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Form, Layout, Rule, cell_jacobians, residual
from ..flows import AbstractFlow
from ..linalg import (
    AbstractSparseSystem,
    BlockPattern,
    Border,
    SparseOperator,
    scatter_blocks,
)
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

    - `t`: the new time.
    - `c0`: leading BDF weight $\delta_0/\tau$.
    - `x_memory`, `memory`: the rest of the BDF sum for the nodes and for the unknowns, so that
      $\dot x = c_0 x + x_{memory}$.
    - `x_hat`, `hat`: positions and unknowns extrapolated to the new time.
    - `data`: nodal data of the flow.
    - `length`: the size of the surface, for scaling.
    """

    t: Float[Array, ""]
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
    flow, c0, frozen.multipliers = args
    return _sum_of_equations(flow, c0, point, trial, trial, frozen, test)


def _linear_integrand(point, trial, frozen, test, args):
    flow, c0, frozen.multipliers = args
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

    The unknowns are all fields, node by node, and the global unknowns of the flow, each divided by
    its typical size. Positions are not unknowns: node by node they follow from the velocity,
    $x = (v - x_{memory})/c_0$, and the Jacobian carries that dependence.
    """

    problem: Problem
    step: StepData

    @property
    def pattern(self):
        return self.problem.pattern

    @property
    def n_globals(self):
        return self.problem.flow.n_globals

    def pack(self, U: Float[Array, "nodes fields"], multipliers: Float[Array, " globals"]):
        """The scaled unknowns of fields and global unknowns."""
        flow, length = self.problem.flow, self.step.length
        tail = multipliers / flow.global_scales(length)
        return jnp.concatenate([(U / flow.scales(length)[None, :]).reshape(-1), tail])

    def unpack(self, y: Float[Array, " unknowns"]):
        """Fields and global unknowns; the inverse of `pack`."""
        flow, length = self.problem.flow, self.step.length
        scales = flow.scales(length)
        n = self.problem.mesh.n_nodes * scales.shape[0]
        return y[:n].reshape(-1, scales.shape[0]) * scales[None, :], y[n:] * flow.global_scales(
            length
        )

    def positions(self, U: Float[Array, "nodes fields"]) -> Float[Array, "nodes 3"]:
        """Nodes at the new time for the unscaled unknowns `U`."""
        return (jax.vmap(self._velocity)(U) - self.step.x_memory) / self.step.c0

    def _velocity(self, U_j):
        flow = self.problem.flow
        return flow.velocity(SimpleNamespace(**flow.layout.split(U_j)))

    def _form(self, multipliers):
        flow = self.problem.flow
        frozen = _joined(flow.data, _prefixed("memory_", flow.layout))
        Z = jnp.concatenate([self.step.data, self.step.memory], axis=1)
        form = Form(_implicit_integrand, flow.layout, frozen)
        return form, Z, (flow, self.step.c0, multipliers)

    def _nodal(self, U, multipliers):
        p = self.problem
        form, Z, args = self._form(multipliers)
        F = residual(form, p.mesh, p.rule, self.positions(U), U, Z, args)
        return F * _row_scales(p.flow, p.mesh, self.step)[None, :]

    def _closures(self, U, multipliers):
        p = self.problem
        fields = p.flow.layout.split(U, axis=1)
        return p.flow.closures(p.mesh, self.step.t, self.positions(U), fields, multipliers)

    def residual(self, y):
        U, multipliers = self.unpack(y)
        F = self._nodal(U, multipliers).reshape(-1)
        if self.n_globals:
            F = jnp.concatenate([F, self._closures(U, multipliers)])
        return F

    def jacobian(self, y):
        p = self.problem
        U, multipliers = self.unpack(y)
        form, Z, args = self._form(multipliers)
        columns = p.flow.scales(self.step.length)
        dx = jax.vmap(jax.jacfwd(self._velocity))(U) / self.step.c0
        local = cell_jacobians(form, p.mesh, p.rule, self.positions(U), U, Z, args, dx)
        rows = _row_scales(p.flow, p.mesh, self.step)
        blocks = scatter_blocks(p.pattern, local) * (rows[:, None] * columns[None, :])[None]
        if not self.n_globals:
            return SparseOperator(blocks, p.pattern)
        scales = p.flow.global_scales(self.step.length)
        by_multiplier = jax.jacfwd(self._nodal, argnums=1)(U, multipliers)
        by_field, corner = jax.jacrev(self._closures, argnums=(0, 1))(U, multipliers)
        border = Border(
            jnp.moveaxis(by_multiplier, -1, 0) * scales[:, None, None],
            by_field * columns[None, None, :],
            corner * scales[None, :],
        )
        return SparseOperator(blocks, p.pattern, border)


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

    @property
    def n_globals(self):
        return 0

    def pack(self, U: Float[Array, "nodes fields"]):
        """The scaled unknowns of this stage out of all fields."""
        return (self._select(U) / self._columns()[None, :]).reshape(-1)

    def unpack(self, y: Float[Array, " unknowns"]) -> Float[Array, "nodes fields"]:
        """All fields, with those of this stage taken from the scaled unknowns."""
        layout = self.problem.flow.layout
        index = jnp.asarray(self._index(layout))
        return self.known.at[:, index].set(self._unscaled(y))

    def _index(self, layout):
        return [k for name in self.fields for k in range(layout.width)[layout.columns(name)]]

    def _select(self, array):
        return array[..., jnp.asarray(self._index(self.problem.flow.layout))]

    def _columns(self):
        return self._select(self.problem.flow.scales(self.step.length))

    def _unscaled(self, y):
        columns = self._columns()
        return y.reshape(-1, columns.shape[0]) * columns[None, :]

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
        return form, Z, (flow, self.step.c0, jnp.zeros(0))

    def residual(self, y):
        p = self.problem
        form, Z, args = self._form()
        F = residual(form, p.mesh, p.rule, self.step.x_hat, self._unscaled(y), Z, args)
        return (F * self._select(_row_scales(p.flow, p.mesh, self.step))[None, :]).reshape(-1)

    def jacobian(self, y):
        p = self.problem
        form, Z, args = self._form()
        U = self._unscaled(y)
        local = cell_jacobians(form, p.mesh, p.rule, self.step.x_hat, U, Z, args)
        rows = self._select(_row_scales(p.flow, p.mesh, self.step))
        blocks = scatter_blocks(p.pattern, local) * (rows[:, None] * self._columns()[None, :])[None]
        return SparseOperator(blocks, p.pattern)

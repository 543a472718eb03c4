"""One time step as a sparse nonlinear system: fully implicit, or linear stage by stage."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Form, Layout, Rule, load, planned_cell_jacobians, residual
from ..flows import System, Units, Whole
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

    flow: System
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
    - `amounts`: the rest of the BDF sum of $(c_j, \chi)_{\Gamma_j}$, one column for every conserved
      field: a fixed vector, so that $\int c$ stays whatever the surface does.
    - `x_hat`, `hat`: positions and unknowns extrapolated to the new time; on a surface that does
      not follow from the unknowns `x_hat` is where it is.
    - `data`: nodal data of the flow.
    - `length`: the size of the surface, for scaling.
    """

    t: Float[Array, ""]
    c0: Float[Array, ""]
    x_memory: Float[Array, "nodes 3"]
    memory: Float[Array, "nodes fields"]
    amounts: Float[Array, "nodes conserved"]
    x_hat: Float[Array, "nodes 3"]
    hat: Float[Array, "nodes fields"]
    data: Float[Array, "nodes data"]
    length: Float[Array, ""]


def scalars(names: tuple[str, ...]) -> Layout:
    """The layout of scalar fields."""
    return Layout(names, (1,) * len(names))


def _prefixed(prefix: str, layout: Layout) -> Layout:
    return Layout(tuple(prefix + name for name in layout.names), layout.sizes)


def _joined(*layouts: Layout) -> Layout:
    return Layout(
        tuple(name for layout in layouts for name in layout.names),
        tuple(size for layout in layouts for size in layout.sizes),
    )


def _rates(flow, c0, trial, frozen) -> SimpleNamespace:
    def rate(name):
        new = c0 * getattr(trial, name).value
        # What a conserved field was is integrated over the surfaces it was on: `StepData.amounts`.
        return new if name in flow.conserved else new + getattr(frozen, f"memory_{name}").value

    return SimpleNamespace(**{name: rate(name) for name in flow.evolving})


def _sum_of_equations(args, point, hat, trial, frozen, test):
    flow, c0, multipliers = args
    rate = _rates(flow, c0, trial, frozen)
    local = flow.local(point, rate, hat, trial, frozen, multipliers)
    return sum(flow.equation(name, local, chi) for name, chi in vars(test).items())


def _implicit_integrand(point, trial, frozen, test, args):
    return _sum_of_equations(args, point, trial, trial, frozen, test)


def _linear_integrand(point, trial, frozen, test, args):
    names = args[0].layout.names
    hat = SimpleNamespace(**{name: getattr(frozen, f"hat_{name}") for name in names})
    known = {name: getattr(frozen, f"known_{name}") for name in names}
    trial = SimpleNamespace(**{**known, **vars(trial)})
    return _sum_of_equations(args, point, hat, trial, frozen, test)


def _row_scales(flow: System, mesh: SurfaceMesh, step: StepData) -> Float[Array, " fields"]:
    """Inverse size of every equation: its leading term at the typical size of its unknown."""
    columns = flow.scales(flow.units(step.length))
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

    @property
    def units(self) -> Units:
        """What unknowns are scaled by."""
        return self.problem.flow.units(self.step.length)

    def pack(self, U: Float[Array, "nodes fields"], multipliers: Float[Array, " globals"]):
        """The scaled unknowns of fields and global unknowns."""
        flow, units = self.problem.flow, self.units
        tail = multipliers / flow.global_scales(units)
        return jnp.concatenate([(U / flow.scales(units)[None, :]).reshape(-1), tail])

    def unpack(self, y: Float[Array, " unknowns"]):
        """Fields and global unknowns; the inverse of `pack`."""
        flow, units = self.problem.flow, self.units
        scales, tail = flow.scales(units), flow.global_scales(units)
        n = self.problem.mesh.n_nodes * scales.shape[0]
        return y[:n].reshape(-1, scales.shape[0]) * scales[None, :], y[n:] * tail

    def positions(self, U: Float[Array, "nodes fields"]) -> Float[Array, "nodes 3"]:
        """Nodes at the new time for the unscaled unknowns `U`."""
        if not self.problem.flow.moves:
            return self.step.x_hat
        return (jax.vmap(self._velocity)(U) - self.step.x_memory) / self.step.c0

    def _velocity(self, U_j):
        return self.problem.flow.velocity_of(U_j)

    def _form(self, multipliers):
        flow = self.problem.flow
        frozen = _joined(scalars(flow.data_names), _prefixed("memory_", flow.layout))
        Z = jnp.concatenate([self.step.data, self.step.memory], axis=1)
        form = Form(_implicit_integrand, flow.layout, frozen)
        return form, Z, (flow, self.step.c0, multipliers)

    def _nodal(self, U, multipliers):
        p = self.problem
        form, Z, args = self._form(multipliers)
        return self._scaled(residual(form, p.mesh, p.rule, self.positions(U), U, Z, args))

    def _scaled(self, F):
        """The assembled form with what conserved fields were before, every row scaled."""
        p = self.problem
        for k, name in enumerate(p.flow.conserved):
            F = F.at[:, p.flow.layout.columns(name)].add(self.step.amounts[:, k : k + 1])
        return F * _row_scales(p.flow, p.mesh, self.step)[None, :]

    def _closures(self, U, multipliers):
        p, t = self.problem, self.step.t
        fields, named = p.flow.layout.split(U, axis=1), p.flow.named(multipliers)
        return p.flow.closures(Whole(t, p.mesh, self.positions(U), fields, named, self.units))

    def residual(self, y):
        U, multipliers = self.unpack(y)
        return self._joined(self._nodal(U, multipliers), U, multipliers)

    def completed(self, F: Float[Array, "nodes fields"], y) -> Float[Array, " unknowns"]:
        """The residual at `y` from the assembled form there."""
        U, multipliers = self.unpack(y)
        return self._joined(self._scaled(F), U, multipliers)

    def _joined(self, F, U, multipliers):
        if not self.n_globals:
            return F.reshape(-1)
        return jnp.concatenate([F.reshape(-1), self._closures(U, multipliers)])

    def jacobian(self, y):
        p, a = self.problem, self.assembly(y)
        local = planned_cell_jacobians(a.form, p.mesh, p.rule, a.x, a.U, a.Z, a.args, a.dx)
        scales = a.rows[:, None] * a.columns[None, :]
        blocks = scatter_blocks(p.pattern, local) * scales[None]
        return SparseOperator(blocks, p.pattern, self.border(y))

    def assembly(self, y) -> "Assembly":
        """What the form is assembled from at `y`, and the scales of its rows and columns."""
        flow = self.problem.flow
        U, multipliers = self.unpack(y)
        form, Z, args = self._form(multipliers)
        dx = jax.vmap(jax.jacfwd(self._velocity))(U) / self.step.c0 if flow.moves else None
        rows = _row_scales(flow, self.problem.mesh, self.step)
        columns, tail = flow.scales(self.units), flow.global_scales(self.units)
        return Assembly(form, self.positions(U), U, Z, args, dx, rows, columns, tail)

    def border(self, y) -> Border | None:
        """Rows and columns of the Jacobian that belong to the global unknowns."""
        if not self.n_globals:
            return None
        U, multipliers = self.unpack(y)
        scales = self.problem.flow.global_scales(self.units)
        by_multiplier = jax.jacfwd(self._nodal, argnums=1)(U, multipliers)
        columns = jnp.moveaxis(by_multiplier, -1, 0) * scales[:, None, None]
        return Border(columns, *self.closure_derivatives(y))

    def closure_derivatives(self, y):
        """Derivatives of the global equations by the nodal and by the global unknowns, scaled."""
        U, multipliers = self.unpack(y)
        columns = self.problem.flow.scales(self.units)
        scales = self.problem.flow.global_scales(self.units)
        by_field, corner = jax.jacrev(self._closures, argnums=(0, 1))(U, multipliers)
        return by_field * columns[None, None, :], corner * scales[None, :]

    def with_exact_amounts(self, U, multipliers) -> Float[Array, "nodes fields"]:
        r"""The same with a constant added to every conserved field, by which its amount is exact.

        The equations of a conserved field, added over all nodes, say what its amount is; Newton's
        method leaves them true to its tolerance, and the constant is smaller than that.
        """
        p = self.problem
        form, Z, args = self._form(multipliers)
        x = self.positions(U)
        F = residual(form, p.mesh, p.rule, x, U, Z, args)
        surface = jnp.sum(load(p.mesh, x, lambda _, __, phi, ___: phi[None]))
        for k, name in enumerate(p.flow.conserved):
            columns = p.flow.layout.columns(name)
            defect = jnp.sum(F[:, columns]) + jnp.sum(self.step.amounts[:, k])
            U = U.at[:, columns].add(-defect / (self.step.c0 * surface))
        return U


class Assembly(eqx.Module):
    r"""A form with everything it is evaluated at.

    **Attributes:**

    - `form`, `x`, `U`, `Z`, `args`: what `fem.residual` takes.
    - `dx`: derivative of the nodes by the unknowns there, or `None` where nodes do not follow them.
    - `rows`, `columns`: what equations are multiplied with, and unknowns measured in.
    - `global_scales`: what global unknowns are measured in.
    """

    form: Form
    x: Float[Array, "nodes 3"]
    U: Float[Array, "nodes fields"]
    Z: Float[Array, "nodes frozen"]
    args: tuple
    dx: Float[Array, "nodes 3 fields"] | None
    rows: Float[Array, " fields"]
    columns: Float[Array, " fields"]
    global_scales: Float[Array, " globals"]


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
        flow = self.problem.flow
        return self._select(flow.scales(flow.units(self.step.length)))

    def _unscaled(self, y):
        columns = self._columns()
        return y.reshape(-1, columns.shape[0]) * columns[None, :]

    def _form(self):
        flow = self.problem.flow
        frozen = _joined(
            scalars(flow.data_names),
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
        local = planned_cell_jacobians(form, p.mesh, p.rule, self.step.x_hat, U, Z, args)
        rows = self._select(_row_scales(p.flow, p.mesh, self.step))
        blocks = scatter_blocks(p.pattern, local) * (rows[:, None] * self._columns()[None, :])[None]
        return SparseOperator(blocks, p.pattern)

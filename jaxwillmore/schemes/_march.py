"""One step of a scheme, and many."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..fem import Form, Rule, cell_jacobians, residual
from ..linalg import BlockPattern, SparseOperator, SparseSolver, block_pattern, scatter_blocks
from ..mesh import SurfaceMesh
from ..surface import area_radius
from ._base import AbstractScheme


class Grid(eqx.Module):
    """What stays the same from step to step: connectivity, quadrature and sparsity."""

    mesh: SurfaceMesh
    rule: Rule
    pattern: BlockPattern


def grid(scheme: AbstractScheme, mesh: SurfaceMesh) -> Grid:
    """The quadrature of `scheme` on `mesh`, whose connectivity must be concrete.

    **Raises:** `ValueError` for a degree that the scheme is not made for.
    """
    return Grid(mesh, scheme.rule(mesh), block_pattern(mesh.cells, mesh.n_nodes))


def _integrand(point, trial, frozen, test, args):
    scheme, tau = args
    return sum(
        scheme.equation(name, point, trial, frozen, tau, chi) for name, chi in vars(test).items()
    )


def step(
    scheme: AbstractScheme,
    grid: Grid,
    x: Float[Array, "nodes 3"],
    tau: Float[Array, ""],
    fields: dict[str, Array],
) -> tuple[Float[Array, "nodes 3"], dict[str, Array]]:
    """Nodes and fields after one step `tau`; differentiable in everything, forward and reverse.

    The equations are affine in the unknowns: their value at zero is the right-hand side, their
    derivative the matrix. Where the linear solver fails, the result is not finite.
    """
    mesh, layout = grid.mesh, scheme.layout
    columns = scheme.scales(jax.lax.stop_gradient(area_radius(mesh, x)))
    Z = _stacked(scheme.data, scheme.nodal_data(mesh, x, fields), mesh.n_nodes)
    form = Form(_integrand, layout, scheme.data)
    zero, args = jnp.zeros((mesh.n_nodes, layout.width)), (scheme, tau)
    F = residual(form, mesh, grid.rule, x, zero, Z, args)
    local = cell_jacobians(form, mesh, grid.rule, x, zero, Z, args)
    blocks = scatter_blocks(grid.pattern, local) * columns[None, None, :]
    # Every row to the size of one, so that pivots are compared by what they mean.
    largest = jnp.zeros_like(F).at[grid.pattern.rows].max(jnp.max(jnp.abs(blocks), axis=2))
    rows = jax.lax.stop_gradient(1 / largest)
    operator = SparseOperator(blocks * rows[grid.pattern.rows][:, :, None], grid.pattern)
    solver = SparseSolver(rtol=1e-12, method="direct")
    solution = lx.linear_solve(operator, -(rows * F).reshape(-1), solver, throw=False)
    U = layout.split(solution.value.reshape(F.shape) * columns[None, :], axis=1)
    return U.pop("x"), U


def _stacked(layout, fields: dict[str, Array], n_nodes: int) -> Float[Array, "nodes fields"]:
    empty = jnp.zeros((n_nodes, 0))
    return jnp.concatenate(
        [empty] + [fields[name].reshape(n_nodes, -1) for name in layout.names], axis=1
    )


class March(eqx.Module):
    """A run of a scheme.

    **Attributes:**

    - `times`, `x`: all times and the nodes at them, the initial ones first.
    - `fields`: the other unknowns at all times, by name.
    """

    times: Float[Array, " times"]
    x: Float[Array, "times nodes 3"]
    fields: dict[str, Array]


@eqx.filter_jit
def _march(scheme, grid, x0, tau, n_steps: int, fields) -> March:
    def advance(carry, _):
        new = step(scheme, grid, carry[0], tau, carry[1])
        return new, new

    _, (x, later) = jax.lax.scan(advance, (x0, fields), length=n_steps)

    def joined(first, rest):
        return jnp.concatenate([first[None], rest])

    times = tau * jnp.arange(n_steps + 1, dtype=float)
    return March(times, joined(x0, x), jax.tree.map(joined, fields, later))


def march(
    scheme: AbstractScheme,
    mesh: SurfaceMesh,
    x0: Float[Array, "nodes 3"],
    *,
    tau: float | Float[Array, ""],
    n_steps: int,
    fields: dict[str, Array] | None = None,
    throw: bool = True,
) -> March:
    """`n_steps` steps of fixed size `tau` from nodes `x0`; differentiable.

    **Arguments:**

    - `fields`: the other unknowns at the start (`run.fields` of an earlier march, say); by default
      they are recovered from the nodes.
    - `throw`: raise `RuntimeError` when a step failed; otherwise the nodes are NaN from there on.

    **Raises:** `ValueError` for a step or a count that is not positive, nodes or fields that do not
    fit, or a degree that the scheme is not made for; `RuntimeError` as said under `throw` (not
    inside a transformation).

    *Limits:* no step control and no check of the triangles: that is what `jaxwillmore.evolve` has.

    ```python
    mesh, x = jw.mesh.icosphere(level=2, degree=1)
    run = jw.schemes.march(jw.schemes.DziukMeanCurvature(), mesh, x, tau=1e-3, n_steps=100)
    ```
    """
    tau = jnp.asarray(tau, float)
    if not isinstance(tau, Tracer) and not (tau > 0 and jnp.isfinite(tau)):
        raise ValueError(f"`tau` must be positive and finite; got {float(tau)}.")
    if n_steps < 1:
        raise ValueError(f"`n_steps` must be at least 1; got {n_steps}.")
    if jnp.shape(x0) != (mesh.n_nodes, 3):
        raise ValueError(f"`x0` must have shape {(mesh.n_nodes, 3)}; got {jnp.shape(x0)}.")
    ready = grid(scheme, mesh)
    names = [name for name in scheme.layout.names if name != "x"]
    if fields is None:
        fields = scheme.initial_fields(mesh, x0)
    elif sorted(fields) != sorted(names):
        raise ValueError(f"`fields` must give {names}; got {sorted(fields)}.")
    run = _march(scheme, ready, jnp.asarray(x0), tau, n_steps, fields)
    if throw and not isinstance(run.x, Tracer):
        _raise_if_lost(run)
    return run


def _raise_if_lost(run: March) -> None:
    finite = np.isfinite(np.asarray(run.x)).all(axis=(1, 2))
    if not finite.all():
        last = int(np.argmin(finite)) - 1
        raise RuntimeError(
            f"The scheme broke down in step {last + 1}, after t = {float(run.times[last]):.6g}: "
            "its linear system could not be solved. Take a smaller `tau`, or look at the triangles "
            "of the last surface with throw=False."
        )

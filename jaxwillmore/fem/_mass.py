"""L² projection: load vectors, mass and stiffness matrices, solves with the mass matrix."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ._integrate import jets_at
from ._metric import point
from ._space import Rule, gather, rule_for, scatter_add


def load(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    density: Callable[..., Float[Array, "..."]],
    fields: dict[str, Float[Array, "nodes ..."]] | None = None,
    *,
    quadrature_degree: int | None = None,
) -> Float[Array, "nodes ..."]:
    r"""The vector $\int f(\varphi_i, \nabla\varphi_i)$ over all basis functions.

    **Arguments:**

    - `density`: `(point, jets, phi, grad_phi) -> value`; `jets.name` is the `Jet` of
      `fields["name"]`.
    """
    fields = {} if fields is None else fields
    rule = rule_for(mesh, quadrature_degree)

    def cell(x_T, fields_T):
        def at(phi, weight):
            X = x_T.T @ phi
            here = point(X[:, 0], X[:, 1:])
            jets = jets_at(here, phi, fields_T)
            tested = jax.vmap(lambda p: density(here, jets, p[0], here.lift @ p[1:]))(phi)
            return weight * here.dA * tested

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights), axis=0)

    local = {name: gather(mesh, field) for name, field in fields.items()}
    return scatter_add(mesh, jax.vmap(cell)(gather(mesh, x), local))


def mass_and_stiffness(
    mesh: SurfaceMesh, rule: Rule, x: Float[Array, "nodes 3"]
) -> tuple[Float[Array, "cells local local"], Float[Array, "cells local local"]]:
    r"""$\int_T\varphi_i\varphi_j$ and $\int_T\nabla\varphi_i\cdot\nabla\varphi_j$, cell by cell."""

    def cell(x_T):
        def at(phi, weight):
            X = x_T.T @ phi
            here = point(X[:, 0], X[:, 1:])
            grad = phi[:, 1:] @ here.lift.T
            return weight * here.dA * jnp.stack([jnp.outer(phi[:, 0], phi[:, 0]), grad @ grad.T])

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights), axis=0)

    both = jax.vmap(cell)(gather(mesh, x))
    return both[:, 0], both[:, 1]


def project(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    b: Float[Array, "nodes components"],
    *,
    tolerance: float = 1e-13,
) -> Float[Array, "nodes components"]:
    r"""Solve $M u = b$ with the consistent mass matrix, by conjugate gradients.

    Scaled by its diagonal the mass matrix has a condition number that depends on the degree alone,
    so a fixed few dozen iterations suffice on every mesh. Differentiable in `x` and `b` by the
    implicit function theorem.
    """
    M, _ = mass_and_stiffness(mesh, rule_for(mesh), x)
    diagonal = scatter_add(mesh, jax.vmap(jnp.diagonal)(M))
    scale = jax.lax.rsqrt(diagonal)[:, None]

    def matvec(u):
        local = jnp.einsum("tij,tj...->ti...", M, gather(mesh, scale * u))
        return scale * scatter_add(mesh, local)

    # The tolerance of CG is absolute, entry by entry: bring the right-hand side to size one.
    size = jax.lax.stop_gradient(jnp.max(jnp.abs(scale * b)))
    size = jnp.where(size > 0, size, 1.0)
    rhs = scale * b / size
    operator = lx.FunctionLinearOperator(
        matvec, jax.eval_shape(lambda: rhs), lx.positive_semidefinite_tag
    )
    solver = lx.CG(rtol=tolerance, atol=tolerance, max_steps=500)
    # No raise: the nodes may not be finite, which whoever asked for the projection reports.
    return size * scale * lx.linear_solve(operator, rhs, solver, throw=False).value

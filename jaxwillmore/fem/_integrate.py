"""Integrals over a discrete surface, and the norms of finite element functions."""

from collections.abc import Callable
from types import SimpleNamespace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arguments import double
from ..mesh import SurfaceMesh
from ._jet import Jet
from ._metric import Point, point
from ._space import Rule, gather, rule_for


def quadrature_sum(
    mesh: SurfaceMesh,
    rule: Rule,
    nodal: Float[Array, "nodes components"],
    at: Callable[[Float[Array, "components 3"]], Float[Array, "..."]],
) -> Float[Array, "..."]:
    r"""$\sum_T\sum_q w_q f(P_q)$ over all cells, without an area element.

    **Arguments:**

    - `at`: the function f of value and two reference derivatives of the components of `nodal`; the
      nodes themselves are among them if it depends on the surface.
    """

    def cell(local):
        return jnp.sum(jax.vmap(lambda p, w: w * at(local.T @ p))(rule.phi, rule.weights), axis=0)

    return jnp.sum(jax.vmap(cell)(gather(mesh, nodal)), axis=0)


def jets_at(
    here: Point, phi: Float[Array, "local 3"], fields: dict[str, Float[Array, "local ..."]]
) -> SimpleNamespace:
    """Jets of the fields of one cell at the quadrature point with tabulated basis `phi`."""
    jets = {}
    for name, local in fields.items():
        part = jnp.tensordot(local, phi, axes=(0, 0))
        jets[name] = Jet(part[..., 0], part[..., 1:] @ here.lift.T)
    return SimpleNamespace(**jets)


def integrate(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    density: Callable[[Point, SimpleNamespace], Float[Array, "..."]],
    fields: dict[str, Float[Array, "nodes ..."]] | None = None,
    *,
    quadrature_degree: int | None = None,
    fine: bool = False,
) -> Float[Array, "..."]:
    """Integral of a density over the surface; differentiable in `x` and in the fields.

    **Arguments:**

    - `density`: `(point, jets) -> value` at one quadrature point; `jets.name` is the `Jet` of the
      nodal field `fields["name"]`.
    - `fields`: nodal arrays of scalar or vector fields.
    - `quadrature_degree`: exactness on the reference triangle; `2 degree + 2` by default, which
      leaves the quadrature error below that of the surface. At most 10.
    - `fine`: use the rule on the four quarters of each cell, for densities that vary within one.

    **Raises:** `ValueError` where `x` does not hold 64-bit floats.

    ```python
    area = jw.fem.integrate(mesh, x, lambda point, _: jnp.ones(()))
    ```
    """
    return jnp.sum(_by_cell(mesh, x, density, fields, quadrature_degree, fine), axis=0)


def integrate_by_cell(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    density: Callable[[Point, SimpleNamespace], Float[Array, "..."]],
    fields: dict[str, Float[Array, "nodes ..."]] | None = None,
    *,
    quadrature_degree: int | None = None,
) -> Float[Array, "cells ..."]:
    """As `integrate`, one number per cell."""
    return _by_cell(mesh, x, density, fields, quadrature_degree)


def _by_cell(mesh, x, density, fields, quadrature_degree, fine=False):
    x, fields = double("x", x), {} if fields is None else fields
    if quadrature_degree is None:
        quadrature_degree = min(2 * mesh.degree + 2, 10)
    rule = rule_for(mesh, quadrature_degree, fine=fine)

    def cell(x_T, fields_T):
        def at(phi, weight):
            X = x_T.T @ phi
            here = point(X[:, 0], X[:, 1:])
            return weight * here.dA * density(here, jets_at(here, phi, fields_T))

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights), axis=0)

    local = {name: gather(mesh, field) for name, field in fields.items()}
    return jax.vmap(cell)(gather(mesh, x), local)


def l2_norm(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], u: Float[Array, "nodes ..."]
) -> Float[Array, ""]:
    r"""$\|u\|_{L^2(\Gamma_h)}$ of a finite element function."""
    return jnp.sqrt(integrate(mesh, x, lambda _, f: jnp.sum(f.u.value**2), {"u": u}))


def h1_norm(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], u: Float[Array, "nodes ..."]
) -> Float[Array, ""]:
    r"""$(\|u\|^2 + \|\nabla_\Gamma u\|^2)^{1/2}$ of a finite element function."""

    def density(_, f):
        return jnp.sum(f.u.value**2) + jnp.sum(f.u.grad**2)

    return jnp.sqrt(integrate(mesh, x, density, {"u": u}))

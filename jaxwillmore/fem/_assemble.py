r"""From an integrand at one quadrature point to residual vectors and sparse Jacobians.

An *integrand* is a function `(point, trial, frozen, test, args) -> scalar` that is linear in the
jets `test`. Because every field enters through its value and two reference derivatives, the
integrand has a *flux*, its gradient with respect to the test jets, and the Jacobian of the flux at
the quadrature point is a small dense matrix D. With the tabulated basis Φ, cell matrices are
`Φᵀ D Φ`: differentiation never sees the nodes.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ._layout import Layout
from ._metric import point
from ._space import Rule, gather, scatter_add

# Cells differentiated together. On a CPU, small batches keep the flux derivative in cache and are
# about twice as fast as one batch over all cells.
CELL_BATCH = 16


class Form(eqx.Module):
    """An integrand with the layouts of its arguments.

    **Arguments:**

    - `integrand`: `(point, trial, frozen, test, args) -> scalar`, linear in `test`.
    - `trial`: layout of the unknowns; `test` has the same one.
    - `frozen`: layout of the nodal fields that are data.
    """

    integrand: Callable = eqx.field(static=True)
    trial: Layout
    frozen: Layout

    def flux(
        self,
        P: Float[Array, "trial 3"],
        X: Float[Array, "3 3"],
        Z: Float[Array, "frozen 3"],
        args: Any,
    ) -> Float[Array, "trial 3"]:
        """Derivative of the integrand, times the area element, by the test jets.

        The arguments hold value and two reference derivatives of the unknowns, of the position
        and of the frozen fields.
        """
        here = point(X[:, 0], X[:, 1:])
        trial, frozen = self.trial.jets(P, here), self.frozen.jets(Z, here)

        def tested(T):
            return here.dA * self.integrand(here, trial, frozen, self.trial.jets(T, here), args)

        return jax.grad(tested)(jnp.zeros_like(P))


class EnergyForm(eqx.Module):
    """The derivative of an integral by the nodal fields it depends on, nodes among them or not.

    Has what a `Form` has; its Jacobian is the second derivative of the integral.

    **Arguments:**

    - `density`: `(P, args) -> scalar`, the integrand times the area element, for values and two
      reference derivatives of the fields, of shape `(fields, 3)`.
    - `trial`: layout of the fields.
    """

    density: Callable = eqx.field(static=True)
    trial: Layout
    frozen: Layout = Layout((), ())

    def flux(
        self,
        P: Float[Array, "trial 3"],
        X: Float[Array, "3 3"],
        Z: Float[Array, "0 3"],
        args: Any,
    ) -> Float[Array, "trial 3"]:
        """Derivative of the density by the jets `P`."""
        del X, Z
        return jax.grad(self.density)(P, args)


def residual(
    form: Form | EnergyForm,
    mesh: SurfaceMesh,
    rule: Rule,
    x: Float[Array, "nodes 3"],
    U: Float[Array, "nodes trial"],
    Z: Float[Array, "nodes frozen"],
    args: Any,
) -> Float[Array, "nodes trial"]:
    """The assembled form, one number per node and equation."""

    def cell(x_T, U_T, Z_T):
        def at(phi, weight):
            flux = form.flux(U_T.T @ phi, x_T.T @ phi, Z_T.T @ phi, args)
            return weight * phi @ flux.T

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights), axis=0)

    return scatter_add(mesh, jax.vmap(cell)(gather(mesh, x), gather(mesh, U), gather(mesh, Z)))


def cell_jacobians(
    form: Form | EnergyForm,
    mesh: SurfaceMesh,
    rule: Rule,
    x: Float[Array, "nodes 3"],
    U: Float[Array, "nodes trial"],
    Z: Float[Array, "nodes frozen"],
    args: Any,
    dx_dU: Float[Array, "nodes 3 trial"] | None = None,
) -> Float[Array, "cells local local trial trial"]:
    """Cell matrices of the derivative of `residual` by `U`, block by block of node pairs.

    With `dx_dU`, positions follow the unknowns node by node, and the derivative is the total one.
    """

    # The sum over quadrature points and reference derivatives is one matrix product per batch.
    pairs = jnp.einsum("q,qmi,qnj->qijmn", rule.weights, rule.phi, rule.phi)

    def cell(x_T, U_T, Z_T, dx_T):
        def by_jets(phi):
            P, X, Z = U_T.T @ phi, x_T.T @ phi, Z_T.T @ phi
            DP = jax.jacfwd(lambda P: form.flux(P, X, Z, args))(P)
            if dx_dU is None:
                return DP, None
            # The form does not move with the position itself unless it says so by its value,
            # hence all three columns of X are differentiated.
            return DP, jax.jacfwd(lambda X: form.flux(P, X, Z, args))(X)

        DP, DX = jax.vmap(by_jets)(rule.phi)
        J = jnp.einsum("qfigj,qijmn->mnfg", DP, pairs)
        if dx_dU is None:
            return J
        JX = jnp.einsum("qficj,qijmn->mnfc", DX, pairs)
        return J + jnp.einsum("mnfc,ncg->mnfg", JX, dx_T)

    def one(inputs):
        return cell(*inputs)

    dx = jnp.zeros((mesh.n_nodes, 0)) if dx_dU is None else dx_dU
    cells = tuple(gather(mesh, a) for a in (x, U, Z, dx))
    return jax.lax.map(one, cells, batch_size=CELL_BATCH)

"""Hu–Li artificial tangential velocity: good meshes without touching the shape."""

from types import SimpleNamespace

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet, Layout, inner
from ..surface import weingarten
from ._base import AbstractFlow


def composed_velocity(V: Jet, nu: Jet, w: Jet) -> Jet:
    r"""$v = V\nu + w$, with the gradient $\nu\otimes\nabla V + V\nabla\nu + \nabla w$."""
    gradient = jnp.outer(nu.value, V.grad) + V.value * nu.grad + w.grad
    return Jet(V.value * nu.value + w.value, gradient)


def deformation_equation(v: Jet, kappa: Jet, nu: Jet, eta: Jet) -> Float[Array, ""]:
    r"""$(\nabla v, \nabla\eta) + (\kappa\nu, \eta) = 0$: least $\int|\nabla v|^2$."""
    return inner(v.grad, eta.grad) + kappa.value * inner(nu.value, eta.value)


def tangency_equation(w: Jet, nu: Jet, xi: Jet) -> Float[Array, ""]:
    r"""$(w\cdot\nu, \xi) = 0$: the constraint $(v\cdot\nu, \xi) = (V, \xi)$ of the minimisation."""
    return inner(w.value, nu.value) * xi.value


class MinimalDeformation(AbstractFlow):
    r"""A flow whose nodes move with the velocity of minimal deformation rate.

    Among all velocities with the normal component $V$ of the flow, $v$ minimises
    $\tfrac12\int|\nabla_\Gamma v|^2$; the shape is that of the plain flow, the triangles stay
    nearly equal. With tangential motion the laws carry the transport terms
    $\partial^\bullet H = \dots + v\cdot\nabla H$ and $\partial^\bullet\nu = \dots + Av$.

    The tangential part $w$ in $v = V\nu + w$ and the multiplier $\kappa$ are unknowns of the same
    implicit system. With $v$ itself as unknown the positions would not follow from $V$ any more,
    and the blocks of the plain flow, which precondition the linear solves, would lose that
    dependence.

    **Arguments:**

    - `flow`: a flow with the unknowns $H$, $V$, $\nu$.

    **Raises:** `ValueError` for a flow with parameters on the nodes (`HelfrichFlow` with fields).

    *Limits:* material fields (phases, moduli) would have to be transported too; move them with the
    plain flow.

    ??? cite "Reference"
        Hu, Li (2022), *Numer. Math.* 150, 1121–1164.
    """

    flow: AbstractFlow

    def __init__(self, flow: AbstractFlow):
        if flow.carried:
            names = ", ".join(f"`{name}`" for name in flow.carried)
            raise ValueError(
                f"`MinimalDeformation` moves nodes along the surface, and {names} would move with "
                "them. Give numbers instead of fields, or run the flow without it."
            )
        self.flow = flow

    @property
    def layout(self) -> Layout:
        base = self.flow.layout
        return Layout((*base.names, "w", "kappa"), (*base.sizes, 3, 1))

    @property
    def evolving(self):
        return self.flow.evolving

    @property
    def data(self):
        return self.flow.data

    @property
    def stages(self):
        return (*self.flow.stages, ("w", "kappa"))

    @property
    def global_names(self):
        return self.flow.global_names

    def equation(self, name, point, rate, hat, trial, data, chi):
        if name == "w":
            v = composed_velocity(trial.V, trial.nu, trial.w)
            return deformation_equation(v, trial.kappa, hat.nu, chi)
        if name == "kappa":
            return tangency_equation(trial.w, hat.nu, chi)
        base = self.flow.equation(name, point, rate, hat, trial, data, chi)
        v = composed_velocity(hat.V, hat.nu, hat.w).value
        if name == "H":
            return base - inner(v, hat.H.grad) * chi.value
        if name == "nu":
            return base - inner(weingarten(hat.nu) @ v, chi.value)
        return base

    def velocity(self, nodal: SimpleNamespace):
        return nodal.V * nodal.nu + nodal.w

    def closures(self, mesh, t, x, fields, multipliers):
        return self.flow.closures(mesh, t, x, fields, multipliers)

    def global_scales(self, length):
        return self.flow.global_scales(length)

    def nodal_data(self, mesh, t, x, fields):
        return self.flow.nodal_data(mesh, t, x, fields)

    def initial_fields(self, mesh, x, given):
        return self.flow.initial_fields(mesh, x, given)

    def energy(self, mesh, x):
        return self.flow.energy(mesh, x)

    def energy_scale(self, mesh, x):
        return self.flow.energy_scale(mesh, x)

    def scales(self, length):
        velocity = length / self.flow.time_scale(length)
        ones = jnp.ones(3)
        return jnp.concatenate(
            [self.flow.scales(length), velocity * ones, velocity[None] / length**2]
        )

    def time_scale(self, length):
        return self.flow.time_scale(length)

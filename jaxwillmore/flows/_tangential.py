"""Hu–Li artificial tangential velocity: good meshes without touching the shape."""

from types import SimpleNamespace

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet, Layout, inner
from ..surface import weingarten
from ._base import AbstractFlow


def deformation_equation(v: Jet, kappa: Jet, nu: Jet, eta: Jet) -> Float[Array, ""]:
    r"""$(\nabla v, \nabla\eta) + (\kappa\nu, \eta) = 0$: least $\int|\nabla v|^2$."""
    return inner(v.grad, eta.grad) + kappa.value * inner(nu.value, eta.value)


def normal_component_equation(v: Jet, V: Jet, nu: Jet, xi: Jet) -> Float[Array, ""]:
    r"""$(v\cdot\nu, \xi) = (V, \xi)$: the constraint of that minimisation."""
    return (inner(v.value, nu.value) - V.value) * xi.value


class MinimalDeformation(AbstractFlow):
    r"""A flow whose nodes move with the velocity of minimal deformation rate.

    Among all velocities with the normal component $V$ of the flow, $v$ minimises
    $\tfrac12\int|\nabla_\Gamma v|^2$; $v$ and the multiplier $\kappa$ are unknowns of the same
    implicit system. The shape is that of the plain flow, the triangles stay nearly equal. With
    tangential motion the laws carry the transport terms
    $\partial^\bullet H = \dots + v\cdot\nabla H$ and $\partial^\bullet\nu = \dots + Av$.

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
        return Layout((*base.names, "v", "kappa"), (*base.sizes, 3, 1))

    @property
    def evolving(self):
        return self.flow.evolving

    @property
    def data(self):
        return self.flow.data

    @property
    def stages(self):
        return (*self.flow.stages, ("v", "kappa"))

    @property
    def global_names(self):
        return self.flow.global_names

    def equation(self, name, point, rate, hat, trial, data, chi):
        if name == "v":
            return deformation_equation(trial.v, trial.kappa, hat.nu, chi)
        if name == "kappa":
            return normal_component_equation(trial.v, trial.V, hat.nu, chi)
        base = self.flow.equation(name, point, rate, hat, trial, data, chi)
        if name == "H":
            return base - inner(hat.v.value, hat.H.grad) * chi.value
        if name == "nu":
            return base - inner(weingarten(hat.nu) @ hat.v.value, chi.value)
        return base

    def velocity(self, nodal: SimpleNamespace):
        return nodal.v

    def closures(self, mesh, t, x, fields, multipliers):
        return self.flow.closures(mesh, t, x, fields, multipliers)

    def global_scales(self, length):
        return self.flow.global_scales(length)

    def nodal_data(self, mesh, t, x, fields, x_hat):
        return self.flow.nodal_data(mesh, t, x, fields, x_hat)

    def initial_fields(self, mesh, x, given):
        return self.flow.initial_fields(mesh, x, given)

    def energy(self, mesh, x):
        return self.flow.energy(mesh, x)

    def scales(self, length):
        velocity = length / self.flow.time_scale(length)
        ones = jnp.ones(3)
        return jnp.concatenate(
            [self.flow.scales(length), velocity * ones, velocity[None] / length**2]
        )

    def time_scale(self, length):
        return self.flow.time_scale(length)

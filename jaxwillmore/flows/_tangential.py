"""Hu–Li artificial tangential velocity: good meshes without touching the shape."""

from types import SimpleNamespace

import equinox as eqx
import jax
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


def transport_equation(rate, w: Jet, phi: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$(\partial^\bullet\phi, \chi) = (w\cdot\nabla\phi, \chi)$ along nodes moving by $V\nu + w$.

    $\phi$ stays on its material points, which move with $V\nu$.
    """
    return (rate - inner(w.value, phi.grad)) * chi.value


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

    Parameters on the nodes (`HelfrichFlow` with fields) belong to material points, which move with
    $V\nu$. Nodes slip past them by $w$, so that the fields become unknowns of the same system,
    under their names, and obey $\partial^\bullet\phi = w\cdot\nabla\phi$ along the nodes. The
    fields of the flow are the initial values; the energy of a state is that of its own fields.

    **Arguments:**

    - `flow`: a flow with the unknowns $H$, $V$, $\nu$.

    *Limits:* the transport has no diffusion of its own. A field that changes over less than a
    triangle overshoots; a modulus that comes near zero may change its sign.

    ??? cite "Reference"
        Hu, Li (2022), *Numer. Math.* 150, 1121–1164.
    """

    flow: AbstractFlow

    def __init__(self, flow: AbstractFlow):
        self.flow = flow

    @property
    def layout(self) -> Layout:
        base, carried = self.flow.layout, self.flow.carried
        names, sizes = (*base.names, "w", "kappa", *carried), (*base.sizes, 3, 1)
        return Layout(names, sizes + (1,) * len(carried))

    @property
    def evolving(self):
        return (*self.flow.evolving, *self.flow.carried)

    @property
    def data(self):
        return self.flow.data

    @property
    def stages(self):
        return (*self.flow.stages, ("w", "kappa"), *((name,) for name in self.flow.carried))

    @property
    def global_names(self):
        return self.flow.global_names

    def equation(self, name, point, rate, hat, trial, data, chi):
        if name == "w":
            v = composed_velocity(trial.V, trial.nu, trial.w)
            return deformation_equation(v, trial.kappa, hat.nu, chi)
        if name == "kappa":
            return tangency_equation(trial.w, hat.nu, chi)
        carried = self.flow.carried
        if name in carried:
            return transport_equation(getattr(rate, name), trial.w, getattr(trial, name), chi)
        # The plain flow finds the fields of the moment in the place of those it was made with.
        fields = {name: getattr(hat, name) for name in carried}
        data = SimpleNamespace(**{**vars(data), **fields})
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
        return self.flow.with_carried(fields).nodal_data(mesh, t, x, fields)

    def initial_fields(self, mesh, x, given):
        carried = {name: given.get(name, phi) for name, phi in self.flow.carried.items()}
        return self.flow.initial_fields(mesh, x, given) | carried

    def with_carried(self, fields):
        return eqx.tree_at(lambda f: f.flow, self, self.flow.with_carried(fields))

    def energy(self, mesh, x):
        return self.flow.energy(mesh, x)

    def energy_scale(self, mesh, x):
        return self.flow.energy_scale(mesh, x)

    def scales(self, length):
        velocity = length / self.flow.time_scale(length)
        tail = [velocity, velocity, velocity, velocity / length**2]
        tail += [_size(phi) for phi in self.flow.carried.values()]
        return jnp.concatenate([self.flow.scales(length), jnp.stack(tail)])

    def time_scale(self, length):
        return self.flow.time_scale(length)


def _size(phi: Float[Array, " nodes"]) -> Float[Array, ""]:
    """The largest value of a field; one for a field that is zero."""
    size = jnp.max(jnp.abs(jax.lax.stop_gradient(phi)))
    return jnp.where(size > 0, size, 1.0)

"""Hu–Li artificial tangential velocity: good meshes without touching the shape."""

from jaxtyping import Array, Float

from ..fem import Jet, inner
from ._law import AbstractLaw, Field, Local, Statement
from ._system import composed_velocity


def deformation_equation(v: Jet, kappa: Jet, nu: Jet, eta: Jet) -> Float[Array, ""]:
    r"""$(\nabla v, \nabla\eta) + (\kappa\nu, \eta) = 0$: least $\int|\nabla v|^2$."""
    return inner(v.grad, eta.grad) + kappa.value * inner(nu.value, eta.value)


def tangency_equation(w: Jet, nu: Jet, xi: Jet) -> Float[Array, ""]:
    r"""$(w\cdot\nu, \xi) = 0$: the constraint $(v\cdot\nu, \xi) = (V, \xi)$ of the minimisation."""
    return inner(w.value, nu.value) * xi.value


class MinimalDeformation(AbstractLaw):
    r"""The tangential motion of minimal deformation rate.

    Among all velocities with the normal component $V$ of the flow, $v$ minimises
    $\tfrac12\int|\nabla_\Gamma v|^2$; the shape is that of the flow without it, the triangles stay
    nearly equal. The tangential part $w$ in $v = V\nu + w$ and the multiplier $\kappa$ are
    unknowns. With $v$ itself as unknown the positions would not follow from $V$ any more, and the
    blocks of the surface's law, which precondition the linear solves, would lose that dependence.

    Every field of the system is transported by its role: curvature and normal obey
    $\partial^\bullet H = \dots + v\cdot\nabla H$ and $\partial^\bullet\nu = \dots + Av$, what
    sits on material points (which move with $V\nu$) obeys $\partial^\bullet\phi =
    w\cdot\nabla\phi$, and densities
    $\mathrm d(c,\chi)/\mathrm dt = \dots - (c\,w, \nabla\chi)$. Parameters on the nodes
    (`HelfrichFlow` with fields) become unknowns; those of the law are the initial values.

    **Raises:** `ValueError` in a `System` without the unknowns $V$ and $\nu$.

    *Limits:* the transport has no diffusion of its own. A field that changes over less than a
    triangle overshoots; a modulus that comes near zero may change its sign.

    ??? cite "Reference"
        Hu, Li (2022), *Numer. Math.* 152, 127–181, doi 10.1007/s00211-022-01309-9.
    """

    def statement(self):
        return Statement(
            fields=(
                Field("w", self._deformation, lambda u: u.velocity, components=3),
                Field("kappa", self._tangency, lambda u: u.velocity / u.length**2),
            ),
            stages=(("w", "kappa"),),
            reads=("V", "nu"),
            velocity=lambda nodal: nodal.w,
        )

    def _deformation(self, s: Local, eta: Jet):
        v = composed_velocity(s.trial.V, s.trial.nu, s.trial.w)
        return deformation_equation(v, s.trial.kappa, s.hat.nu, eta)

    def _tangency(self, s: Local, xi: Jet):
        return tangency_equation(s.trial.w, s.hat.nu, xi)

r"""Canham–Helfrich flow with moduli and spontaneous curvature that vary over the surface.

For $E = \int \tfrac\kappa2 (H - H_0)^2 + b_k K$, $\kappa = 2 b_b$, with fields that stay on their
material points, $\partial^\bullet \kappa = \partial^\bullet H_0 = \partial^\bullet b_k = 0$ along
$V\nu$, the L² gradient flow is $V = \Delta_\Gamma U + Q$ with $U = \kappa (H - H_0)$ and

$$ Q = |A|^2 U - \tfrac12 \kappa H (H - H_0)^2 + q, \qquad
   q = \nabla_\Gamma\cdot((H I - A) \nabla_\Gamma b_k). $$

The normal obeys $\partial^\bullet\nu = -\nabla\Delta U - \nabla Q$; $g = \nabla U$ takes the place
of $z$ in the Kovács–Li–Lubich system, and $q$ is an unknown too, so that $Q$ is a number at a
quadrature point. Every function below is one equation at one quadrature point, left side minus
right side. For constant fields, $g = \kappa z$ and the system is that of `WillmoreFlow`, term by
term.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import CanhamHelfrich, modulus_at, modulus_jet, non_negative
from ..fem import Jet, inner, trace
from ..surface import gaussian_curvature, nodal_weingarten_squared, weingarten
from ._consistency import (
    checked_weight,
    consistency_weight,
    mean_curvature_consistency,
    normal_consistency,
)
from ._geometry import (
    geometric_fields,
    geometry_record,
    normal_motion,
    recovered_geometry,
    speed_at_rest,
)
from ._law import AbstractLaw, Field, Local, Statement, Whole
from ._willmore import check_resolution, mean_curvature_equation

PARAMETERS = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")


def potential_gradient(H: Jet, kappa: Jet, H0: Jet) -> Float[Array, "3"]:
    r"""$\nabla U$ of $U = \kappa (H - H_0)$: $\kappa\nabla(H - H_0) + (H - H_0)\nabla\kappa$."""
    return kappa.value * (H.grad - H0.grad) + (H.value - H0.value) * kappa.grad


def lower_order_force(hat, kappa: Jet, H0: Jet) -> Float[Array, ""]:
    r"""$|A|^2 U - \tfrac12 \kappa H (H - H_0)^2$, what of $Q$ has no derivatives of the fields."""
    A, H = weingarten(hat.nu), hat.H.value
    excess = H - H0.value
    return kappa.value * (inner(A, A) * excess - 0.5 * H * excess**2)


def potential_velocity_equation(V: Jet, grad_U, Q, chi: Jet) -> Float[Array, ""]:
    r"""$(V, \chi) = -(\nabla U, \nabla\chi) + (Q, \chi)$."""
    return V.value * chi.value + inner(grad_U, chi.grad) - Q * chi.value


def potential_normal_equation(rate, g: Jet, hat, grad_U, Q, chi: Jet) -> Float[Array, ""]:
    r"""The normal under $V = \Delta U + Q$, where $g$ is an unknown for $\nabla U$:

    $$ (\partial^\bullet\nu, \chi) = (\nabla g, \nabla\chi) + ((HA - A^2) g, \chi)
       + ((\nabla H\cdot\nabla U)\nu, \chi) + (A^2\nabla U, \chi)
       + 2 (A\nabla U, (\nabla\chi)\nu) + (Q, \nabla\cdot\chi) - (Q H \nu, \chi) $$

    For $U = \kappa H$ with constant $\kappa$ it is (10c). On $\nabla\chi$ see `normal_equation`
    there.
    """
    A, H, nu = weingarten(hat.nu), hat.H.value, hat.nu.value
    flux = (
        inner(g.grad, chi.grad)
        + inner((H * A - A @ A) @ g.value, chi.value)
        + inner(hat.H.grad, grad_U) * inner(nu, chi.value)
        + inner(A @ A @ grad_U, chi.value)
        + 2.0 * inner(A @ grad_U, chi.grad.T @ nu)
    )
    force = Q * trace(chi.grad) - Q * H * inner(nu, chi.value)
    return inner(rate, chi.value) - flux - force


def potential_gradient_equation(g: Jet, nu: Jet, hat, kappa: Jet, H0: Jet, chi: Jet):
    r"""$g = \nabla U$ without derivatives of $H$, by $\nabla H = \Delta\nu + |A|^2\nu$:

    $$ (g, \chi) = -(\nabla\nu, \nabla(\kappa\chi)) + (\kappa |A|^2 \nu, \chi)
       - (\kappa \nabla H_0, \chi) + ((H - H_0) \nabla\kappa, \chi) $$
    """
    A = weingarten(hat.nu)
    weighted = kappa.value * chi.grad + jnp.outer(chi.value, kappa.grad)
    known = (hat.H.value - H0.value) * kappa.grad - kappa.value * H0.grad
    return (
        inner(g.value, chi.value)
        + inner(nu.grad, weighted)
        - kappa.value * inner(A, A) * inner(nu.value, chi.value)
        - inner(known, chi.value)
    )


def gaussian_force_equation(q: Jet, hat, b_k: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$(q, \chi) = -((H I - A) \nabla b_k, \nabla\chi)$."""
    A = weingarten(hat.nu)
    flux = hat.H.value * b_k.grad - A @ b_k.grad
    return q.value * chi.value + inner(flux, chi.grad)


class HelfrichFlow(AbstractLaw):
    r"""Canham–Helfrich flow with parameters that are numbers, fields, or depend on a concentration.

    $$ V = \Delta_\Gamma(\kappa (H - H_0)) + |A|^2 \kappa (H - H_0) - \tfrac12 \kappa H (H - H_0)^2
       + \nabla_\Gamma\cdot((H I - A) \nabla_\Gamma b_k) + f, \qquad \kappa = 2 b_b $$

    with the normal force $f$ of the other laws of its system. Unknowns are $H, V, \nu, g$ and,
    where $b_k$ varies, $q$. Nodes move with $V\nu$ and carry nodal fields along; functions of the
    concentration $c$ are evaluated at the quadrature points. The consistency terms are those of
    `WillmoreFlow`, with the weight $\alpha = c \max(\kappa |A_h|^4)$.

    **Arguments:**

    - `bending_modulus`: $b_b$, energy.
    - `spontaneous_curvature`: $H_0$, 1/length, for the sum of the principal curvatures.
    - `gaussian_modulus`: $b_k$, energy. A number does nothing on a closed surface but add
      $2\pi\chi\,b_k$ to the energy.
    - `consistency`, `consistency_weight`: as in `WillmoreFlow`.

    Each of the three is a number, an array with one number for every node, a `Mixture`, or another
    function of $c$ (give an `eqx.Module` to keep its parameters differentiable).

    **Raises:** `ValueError` for a modulus that is not positive, a negative `consistency`, or a
    parameter that is not finite; for a function of $c$ in a system without one; when a run starts,
    for a field that does not have one number for every node, and for an $H_0$ beyond the inverse
    distance between the nodes.

    *Limits:* jumps in the fields are smeared over a triangle.

    ```python
    stiff = 0.5 + 0.2 * x[:, 2]
    flow = jw.flows.HelfrichFlow(stiff, spontaneous_curvature=0.5)
    ```
    """

    energy: CanhamHelfrich
    consistency: Float[Array, ""]
    consistency_weight: str = eqx.field(static=True)

    def __init__(
        self,
        bending_modulus: Any = 0.5,
        spontaneous_curvature: Any = 0.0,
        gaussian_modulus: Any = 0.0,
        consistency=6.0,
        consistency_weight="global",
    ):
        self.energy = CanhamHelfrich(bending_modulus, gaussian_modulus, spontaneous_curvature)
        self.consistency = non_negative("consistency", consistency)
        self.consistency_weight = checked_weight(consistency_weight)

    def statement(self):
        fields = geometric_fields(self._mean_curvature, self._velocity, self._normal, self._time)
        size = lambda u: u.length**2 / self._time(u.length)
        fields += (Field("g", self._potential_gradient, size, components=3),)
        stages = (("nu", "g"), ("H", "V"))
        if self._has_gaussian_force:
            speed = lambda u: u.length / self._time(u.length)
            fields += (Field("q", self._gaussian_force, speed),)
            stages = (("q",), *stages)
        mixed = self._mixed
        return Statement(
            fields=fields,
            stages=stages,
            reads=("c",) if mixed else (),
            start=self._start,
            velocity=normal_motion,
            density=self._density if mixed else None,
            data={"alpha": self._weight},
            carried=self._carried,
            energy=self.energy,
            length_time=self._time,
            record=geometry_record,
            activity=speed_at_rest(self._time),
            implicit_only=bool(mixed),
        )

    @property
    def _parameters(self) -> dict[str, Any]:
        return {name: getattr(self.energy, name) for name in PARAMETERS}

    @property
    def _mixed(self) -> list[str]:
        """The parameters that depend on the concentration."""
        return [name for name, p in self._parameters.items() if callable(p)]

    @property
    def _carried(self) -> dict[str, Array]:
        """The parameters that sit on the nodes."""
        return {n: p for n, p in self._parameters.items() if not callable(p) and p.ndim}

    @property
    def _has_gaussian_force(self) -> bool:
        b_k = self.energy.gaussian_modulus
        return callable(b_k) or b_k.ndim == 1

    def _jet(self, s: Local, name: str) -> Jet:
        parameter = self._parameters[name]
        if callable(parameter):
            return modulus_jet(parameter, s.hat.c)
        return getattr(s.data, name) if parameter.ndim else Jet(parameter, jnp.zeros(3))

    def _bending(self, s: Local) -> tuple[Jet, Jet]:
        """κ = 2 b_b and H₀."""
        b_b, H0 = (self._jet(s, name) for name in PARAMETERS[:2])
        return Jet(2 * b_b.value, 2 * b_b.grad), H0

    def _force(self, s: Local, kappa: Jet, H0: Jet):
        Q = lower_order_force(s.hat, kappa, H0) + s.force()
        # An earlier stage has solved for q; its extrapolation is not known in the first step.
        return Q + s.trial.q.value if self._has_gaussian_force else Q

    def _mean_curvature(self, s: Local, chi: Jet):
        return mean_curvature_equation(s.rate.H, s.trial.V, s.hat, chi) + (
            mean_curvature_consistency(s.trial.H, s.trial.nu, s.data.alpha, chi)
        )

    def _velocity(self, s: Local, chi: Jet):
        kappa, H0 = self._bending(s)
        grad_U = potential_gradient(s.trial.H, kappa, H0)
        return potential_velocity_equation(s.trial.V, grad_U, self._force(s, kappa, H0), chi)

    def _normal(self, s: Local, chi: Jet):
        kappa, H0 = self._bending(s)
        grad_U, Q = potential_gradient(s.hat.H, kappa, H0), self._force(s, kappa, H0)
        return potential_normal_equation(s.rate.nu, s.trial.g, s.hat, grad_U, Q, chi) + (
            normal_consistency(s.trial.nu, s.point, s.data.alpha, chi)
        )

    def _potential_gradient(self, s: Local, chi: Jet):
        kappa, H0 = self._bending(s)
        return potential_gradient_equation(s.trial.g, s.trial.nu, s.hat, kappa, H0, chi)

    def _gaussian_force(self, s: Local, chi: Jet):
        return gaussian_force_equation(s.trial.q, s.hat, self._jet(s, "gaussian_modulus"), chi)

    def _density(self, s: Local, c: Jet):
        r"""$b_b (H - H_0)^2 + b_k K$ as a function of the concentration."""
        nodal = {name: getattr(s.data, name) for name in self._carried}
        return self.energy.density(c, s.hat.H.value, gaussian_curvature(s.A), nodal)

    def _weight(self, s: Whole):
        b_b = self.energy.bending_modulus
        b_b = s.fields.get(
            "bending_modulus", modulus_at(b_b, s.fields["c"]) if callable(b_b) else b_b
        )
        A2 = nodal_weingarten_squared(s.mesh, s.x, s.fields["nu"])
        return consistency_weight(
            self.consistency_weight, self.consistency, jnp.broadcast_to(2 * b_b, A2.shape) * A2**2
        )

    def _start(self, mesh, x, given):
        for H0 in _ends(self.energy.spontaneous_curvature):
            check_resolution(jnp.max(jnp.abs(H0)), mesh, x)
        return recovered_geometry(mesh, x, given)

    def _time(self, length):
        b_b = jnp.stack([jnp.mean(b) for b in _ends(self.energy.bending_modulus)])
        return length**4 / (2 * jnp.mean(b_b))


def _ends(parameter) -> tuple:
    """A parameter, or a function of the concentration in both pure phases."""
    if not callable(parameter):
        return (parameter,)
    return tuple(jnp.asarray(parameter(jnp.asarray(c)), float) for c in (0.0, 1.0))

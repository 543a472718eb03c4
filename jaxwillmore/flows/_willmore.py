r"""Willmore and Canham–Helfrich flow: the Kovács–Li–Lubich system.

The law is $V = 2 b_b (\Delta_\Gamma H + |A|^2 (H - H_0) - \tfrac12 H (H - H_0)^2)$, the L² gradient
flow of $\int b_b (H - H_0)^2$; with $b_b = \tfrac12$ and $H_0 = 0$ it is Willmore flow
$V = \Delta_\Gamma H - \tfrac12 H^3 + |A|^2 H$. Every function below is one equation at one
quadrature point, left side minus right side.

The normal equation is (10c). Its discrete version (13c) is often printed without the terms
$(HA - A^2)z$, $2(A\nabla H, (\nabla\chi)\nu)$, $(Q, \nabla\cdot\chi)$ and $-(QH\nu, \chi)$;
they are all here.
"""

import math

import equinox as eqx
from jax.core import Tracer
from jaxtyping import Array, Float

from ..energies import CanhamHelfrich, finite, non_negative, positive
from ..fem import Jet, inner, trace
from ..surface import area, nodal_weingarten_squared, weingarten
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
from ._law import AbstractLaw, Field, Local, Statement


def mean_curvature_equation(rate, V: Jet, hat, chi: Jet) -> Float[Array, ""]:
    r"""(10a)  $(\partial^\bullet H, \chi) = (\nabla V, \nabla\chi) - (|A|^2 V, \chi)$."""
    A = weingarten(hat.nu)
    return rate * chi.value - inner(V.grad, chi.grad) + inner(A, A) * V.value * chi.value


def normal_velocity_equation(V: Jet, H: Jet, kappa, Q, chi: Jet) -> Float[Array, ""]:
    r"""(10b)  $(V, \chi) = -\kappa (\nabla H, \nabla\chi) + (Q, \chi)$ with $\kappa = 2 b_b$."""
    return V.value * chi.value + kappa * inner(H.grad, chi.grad) - Q * chi.value


def normal_equation(rate, z: Jet, hat, kappa, Q, chi: Jet) -> Float[Array, ""]:
    r"""(10c), with $\kappa = 2 b_b$ before every term of the flux of $\kappa\,\Delta H$:

    $$ (\partial^\bullet\nu, \chi) = \kappa\,[(\nabla z, \nabla\chi) + ((HA - A^2) z, \chi)
       + (|\nabla H|^2 \nu, \chi) + (A^2\nabla H, \chi) + 2 (A\nabla H, (\nabla\chi)\nu)]
       + (Q, \nabla\cdot\chi) - (Q H \nu, \chi) $$

    $(\nabla\chi)\nu$ has components $\sum_j \nu_j D_k\chi_j$. With gradients as rows, as `Jet` has
    them, that is $J^T\nu$; $J\nu$ vanishes identically.
    """
    A, H, nu, g = weingarten(hat.nu), hat.H.value, hat.nu.value, hat.H.grad
    flux = (
        inner(z.grad, chi.grad)
        + inner((H * A - A @ A) @ z.value, chi.value)
        + inner(g, g) * inner(nu, chi.value)
        + inner(A @ A @ g, chi.value)
        + 2.0 * inner(A @ g, chi.grad.T @ nu)
    )
    force = Q * trace(chi.grad) - Q * H * inner(nu, chi.value)
    return inner(rate, chi.value) - kappa * flux - force


def auxiliary_normal_equation(z: Jet, nu: Jet, hat, chi: Jet) -> Float[Array, ""]:
    r"""(10d)  $(z, \chi) = -(\nabla\nu, \nabla\chi) + (|A|^2\nu, \chi)$."""
    A = weingarten(hat.nu)
    return (
        inner(z.value, chi.value)
        + inner(nu.grad, chi.grad)
        - inner(A, A) * inner(nu.value, chi.value)
    )


class WillmoreFlow(AbstractLaw):
    r"""Willmore flow and its Canham–Helfrich generalisation with constant coefficients.

    $$ V = 2 b_b\,[\Delta_\Gamma H + |A|^2 (H - H_0) - \tfrac12 H (H - H_0)^2] + f $$

    with the normal force $f$ of the other laws of its system. Unknowns are $H, V, \nu, z$ with
    $z = \Delta\nu + |A|^2\nu$ ($= \nabla H$), all in the Lagrange space of the surface; nodes move
    with $V\nu$.

    The plain system ties $H_h$, $\nu_h$ and $x_h$ only through the evolution and is linearly
    unstable off that manifold: on the unit sphere $|\nu_h| - 1$ grows at rate $+8$. Two consistency
    terms, `mean_curvature_consistency` and `normal_consistency`, weighted with
    $\alpha = c\,2b_b\,\max|A_h|^4$ of the extrapolated surface, cure it and vanish on the exact
    solution.

    **Arguments:**

    - `bending_modulus`: $b_b$, energy; $\tfrac12\int H^2$ is $b_b = 1/2$. From the physicists'
      $\kappa$: $b_b = \kappa/2$.
    - `spontaneous_curvature`: $H_0$, 1/length, for the sum of the principal curvatures.
    - `consistency`: $c$; 0 switches the consistency terms off, and below about 4 they are too weak.
    - `consistency_weight`: `"global"` (the maximum as a power mean of order 16, which has
      derivatives), or `"local"` for $\alpha = c\,2b_b\,|A_h|^4$ node by node.

    *Limits:* size, and for tori reduced volume, cost no energy at $H_0 = 0$, so the error of the
    mesh moves a surface at rest along them: a Möbius image of the Clifford torus gains 1.9 % of
    area until $t = R_0^4/2b_b$ on 864 nodes of degree 2, 0.6 % on 1,536 and 0.03 % on 1,536 of
    degree 4, whatever the step. Hold area and volume (`Loads`), or take a finer mesh or degree 4.

    **Raises:** `ValueError` for a modulus that is not positive, a negative `consistency`, or a
    parameter that is not one finite number; when a run starts, for an $H_0$ beyond the inverse
    distance between the nodes.

    ??? cite "Reference"
        Kovács, Li, Lubich (2021), *Numer. Math.* 149, 595–643, equations (10a)–(10e).
    """

    bending_modulus: Float[Array, ""]
    spontaneous_curvature: Float[Array, ""]
    consistency: Float[Array, ""]
    consistency_weight: str = eqx.field(static=True)

    def __init__(
        self,
        bending_modulus=0.5,
        spontaneous_curvature=0.0,
        consistency=6.0,
        consistency_weight="global",
    ):
        self.bending_modulus = positive("bending_modulus", bending_modulus)
        self.spontaneous_curvature = finite("spontaneous_curvature", spontaneous_curvature)
        self.consistency = non_negative("consistency", consistency)
        self.consistency_weight = checked_weight(consistency_weight)

    def statement(self):
        def time(length):
            return length**4 / (2 * self.bending_modulus)

        fields = geometric_fields(self._mean_curvature, self._velocity, self._normal, time)
        z = Field("z", self._auxiliary_normal, lambda u: 1 / u.length**2, components=3)
        return Statement(
            fields=(*fields, z),
            stages=(("nu", "z"), ("H", "V")),
            start=self._start,
            velocity=normal_motion,
            data={"alpha": self._weight},
            energy=CanhamHelfrich(self.bending_modulus, 0.0, self.spontaneous_curvature),
            length_time=time,
            record=geometry_record,
            activity=speed_at_rest(time),
        )

    def force(self, hat) -> Float[Array, ""]:
        r"""$Q = \kappa\,[|A|^2 (H - H_0) - \tfrac12 H (H - H_0)^2]$, the lower-order part."""
        A, H = weingarten(hat.nu), hat.H.value
        excess = H - self.spontaneous_curvature
        return 2 * self.bending_modulus * (inner(A, A) * excess - 0.5 * H * excess**2)

    def _mean_curvature(self, s: Local, chi: Jet):
        return mean_curvature_equation(s.rate.H, s.trial.V, s.hat, chi) + (
            mean_curvature_consistency(s.trial.H, s.trial.nu, s.data.alpha, chi)
        )

    def _velocity(self, s: Local, chi: Jet):
        kappa, Q = 2 * self.bending_modulus, self.force(s.hat) + s.force()
        return normal_velocity_equation(s.trial.V, s.trial.H, kappa, Q, chi)

    def _normal(self, s: Local, chi: Jet):
        kappa, Q = 2 * self.bending_modulus, self.force(s.hat) + s.force()
        return normal_equation(s.rate.nu, s.trial.z, s.hat, kappa, Q, chi) + (
            normal_consistency(s.trial.nu, s.point, s.data.alpha, chi)
        )

    def _auxiliary_normal(self, s: Local, chi: Jet):
        return auxiliary_normal_equation(s.trial.z, s.trial.nu, s.hat, chi)

    def _weight(self, s):
        A2 = nodal_weingarten_squared(s.mesh, s.x, s.fields["nu"])
        rate = self.consistency * 2 * self.bending_modulus
        return consistency_weight(self.consistency_weight, rate, A2**2)

    def _start(self, mesh, x, given):
        check_resolution(self.spontaneous_curvature, mesh, x)
        return recovered_geometry(mesh, x, given)


def check_resolution(H0, mesh, x):
    """Refuse a spontaneous curvature that the nodes cannot follow; traced values pass unchecked."""
    size = area(mesh, x)
    # Inside a compiled function the area is traced even where the nodes are not.
    if isinstance(H0, Tracer) or isinstance(size, Tracer):
        return
    spacing = math.sqrt(size / mesh.n_nodes)
    if abs(H0) * spacing > 1:
        raise ValueError(
            f"`spontaneous_curvature` must be below {1 / spacing:.3g} in size on this mesh, the "
            f"inverse of the distance between its nodes; got {H0:.6g}. Refine the mesh, or mind "
            "the unit: 1/length, for the sum of the principal curvatures."
        )

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
from collections.abc import Callable
from types import SimpleNamespace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from ..energies import CanhamHelfrich, finite, non_negative, positive
from ..fem import Jet, Layout, inner, trace
from ..surface import (
    area,
    nodal_weingarten_squared,
    recover_mean_curvature,
    recover_normal,
    weingarten,
)
from ._base import AbstractFlow
from ._consistency import (
    checked_weight,
    consistency_weight,
    mean_curvature_consistency,
    normal_consistency,
)


def mean_curvature_equation(rate, V: Jet, hat, chi: Jet) -> Float[Array, ""]:
    r"""(10a)  $(\partial^\bullet H, \chi) = (\nabla V, \nabla\chi) - (|A|^2 V, \chi)$."""
    A = weingarten(hat.nu)
    return rate * chi.value - inner(V.grad, chi.grad) + inner(A, A) * V.value * chi.value


def normal_velocity_equation(V: Jet, H: Jet, b, Q, chi: Jet) -> Float[Array, ""]:
    r"""(10b)  $(V, \chi) = -b (\nabla H, \nabla\chi) + (Q, \chi)$ with $b = 2 b_b$."""
    return V.value * chi.value + b * inner(H.grad, chi.grad) - Q * chi.value


def normal_equation(rate, z: Jet, hat, b, Q, chi: Jet) -> Float[Array, ""]:
    r"""(10c), with $b = 2 b_b$ before every term of the flux of $b\,\Delta H$:

    $$ (\partial^\bullet\nu, \chi) = b\,[(\nabla z, \nabla\chi) + ((HA - A^2) z, \chi)
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
    return inner(rate, chi.value) - b * flux - force


def auxiliary_normal_equation(z: Jet, nu: Jet, hat, chi: Jet) -> Float[Array, ""]:
    r"""(10d)  $(z, \chi) = -(\nabla\nu, \nabla\chi) + (|A|^2\nu, \chi)$."""
    A = weingarten(hat.nu)
    return (
        inner(z.value, chi.value)
        + inner(nu.grad, chi.grad)
        - inner(A, A) * inner(nu.value, chi.value)
    )


class WillmoreFlow(AbstractFlow):
    r"""Willmore flow and its Canham–Helfrich generalisation with constant coefficients.

    $$ V = 2 b_b\,[\Delta_\Gamma H + |A|^2 (H - H_0) - \tfrac12 H (H - H_0)^2] + f $$

    Unknowns are $H, V, \nu, z$ with $z = \Delta\nu + |A|^2\nu$ ($= \nabla H$), all in the Lagrange
    space of the surface; nodes move with $V\nu$.

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
    - `forcing`: a function `(t, x) -> scalar` of time and one point: a normal velocity $f$ added to
      the law (manufactured solutions, external fields). It is evaluated at the extrapolated nodes.

    **Raises:** `ValueError` for a modulus that is not positive, a negative `consistency`, or a
    parameter that is not one finite number; when a run starts, for an $H_0$ beyond the inverse
    distance between the nodes.

    ??? cite "Reference"
        Kovács, Li, Lubich (2021), *Numer. Math.* 149, 595–643, equations (10a)–(10e).
    """

    bending_modulus: Float[Array, ""]
    spontaneous_curvature: Float[Array, ""]
    consistency: Float[Array, ""]
    forcing: Callable | None
    consistency_weight: str = eqx.field(static=True)

    layout: ClassVar[Layout] = Layout(("H", "V", "nu", "z"), (1, 1, 3, 3))
    evolving: ClassVar[tuple[str, ...]] = ("H", "nu")
    data: ClassVar[Layout] = Layout(("alpha", "force"), (1, 1))
    global_names: ClassVar[tuple[str, ...]] = ()
    stages: ClassVar[tuple[tuple[str, ...], ...]] = (("nu", "z"), ("H", "V"))

    def __init__(
        self,
        bending_modulus=0.5,
        spontaneous_curvature=0.0,
        consistency=6.0,
        forcing=None,
        consistency_weight="global",
    ):
        self.bending_modulus = positive("bending_modulus", bending_modulus)
        self.spontaneous_curvature = finite("spontaneous_curvature", spontaneous_curvature)
        self.consistency = non_negative("consistency", consistency)
        self.forcing = forcing
        self.consistency_weight = checked_weight(consistency_weight)

    def force(self, hat) -> Float[Array, ""]:
        r"""$Q = b\,[|A|^2 (H - H_0) - \tfrac12 H (H - H_0)^2]$, the lower-order part of the law."""
        A, H = weingarten(hat.nu), hat.H.value
        excess = H - self.spontaneous_curvature
        return 2 * self.bending_modulus * (inner(A, A) * excess - 0.5 * H * excess**2)

    def equation(self, name, point, rate, hat, trial, data, chi):
        b = 2 * self.bending_modulus
        if name == "H":
            return mean_curvature_equation(rate.H, trial.V, hat, chi) + (
                mean_curvature_consistency(trial.H, trial.nu, data.alpha, chi)
            )
        if name == "V":
            Q = self.force(hat) + data.force.value
            return normal_velocity_equation(trial.V, trial.H, b, Q, chi)
        if name == "nu":
            Q = self.force(hat) + data.force.value
            return normal_equation(rate.nu, trial.z, hat, b, Q, chi) + (
                normal_consistency(trial.nu, point, data.alpha, chi)
            )
        return auxiliary_normal_equation(trial.z, trial.nu, hat, chi)

    def velocity(self, nodal: SimpleNamespace) -> Float[Array, "3"]:
        """(10e)  v = V ν, node by node."""
        return nodal.V * nodal.nu

    def closures(self, mesh, t, x, fields, multipliers):
        return jnp.zeros(0)

    def global_scales(self, length):
        return jnp.zeros(0)

    def nodal_data(self, mesh, t, x, fields):
        A2 = nodal_weingarten_squared(mesh, x, fields["nu"])
        rate = self.consistency * 2 * self.bending_modulus
        alpha = consistency_weight(self.consistency_weight, rate, A2**2)
        force = jnp.zeros(mesh.n_nodes)
        forcing = self.forcing
        if forcing is not None:
            force = jax.vmap(lambda p: forcing(t, p))(x)
        return jnp.stack([alpha, force], axis=1)

    def initial_fields(self, mesh, x, given):
        check_resolution(self.spontaneous_curvature, mesh, x)
        nu = given["nu"] if "nu" in given else recover_normal(mesh, x)
        H = given["H"] if "H" in given else recover_mean_curvature(mesh, x)
        return {"H": H, "nu": nu}

    def with_carried(self, fields):
        return self

    def energy(self, mesh, x):
        return self._bending_energy()(mesh, x)

    def energy_scale(self, mesh, x):
        return self._bending_energy().scale(mesh, x)

    def _bending_energy(self):
        return CanhamHelfrich(self.bending_modulus, 0.0, self.spontaneous_curvature)

    def scales(self, length):
        b = 2 * self.bending_modulus
        one = jnp.ones(())
        H, V, nu, z = 1 / length, b / length**3, one, 1 / length**2
        return jnp.stack([H, V, nu, nu, nu, z, z, z])

    def time_scale(self, length):
        return length**4 / (2 * self.bending_modulus)


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

r"""Canham–Helfrich flow with moduli and spontaneous curvature that the surface carries.

For $E = \int \tfrac b2 (H - H_0)^2 + b_k K$, $b = 2 b_b$, with fields that stay on their material
points, $\partial^\bullet b = \partial^\bullet H_0 = \partial^\bullet b_k = 0$ along $V\nu$, the L²
gradient flow is $V = \Delta_\Gamma U + Q$ with $U = b (H - H_0)$ and

$$ Q = |A|^2 U - \tfrac12 b H (H - H_0)^2 + q, \qquad
   q = \nabla_\Gamma\cdot((H I - A) \nabla_\Gamma b_k). $$

The normal obeys $\partial^\bullet\nu = -\nabla\Delta U - \nabla Q$; $g = \nabla U$ takes the place
of $z$ in the Kovács–Li–Lubich system, and $q$ is an unknown too, so that $Q$ is a number at a
quadrature point. Every function below is one equation at one quadrature point, left side minus
right side. For constant fields, $g = b z$ and the system is that of `WillmoreFlow`, term by term.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import CanhamHelfrich, finite_field, non_negative, on_nodes, positive_field
from ..fem import Jet, Layout, inner, trace
from ..surface import (
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
from ._willmore import check_resolution, mean_curvature_equation


def potential_gradient(H: Jet, b: Jet, H0: Jet) -> Float[Array, "3"]:
    r"""$\nabla U = b (\nabla H - \nabla H_0) + (H - H_0) \nabla b$ of $U = b (H - H_0)$."""
    return b.value * (H.grad - H0.grad) + (H.value - H0.value) * b.grad


def lower_order_force(hat, b: Jet, H0: Jet) -> Float[Array, ""]:
    r"""$|A|^2 U - \tfrac12 b H (H - H_0)^2$, the part of $Q$ without derivatives of the fields."""
    A, H = weingarten(hat.nu), hat.H.value
    excess = H - H0.value
    return b.value * (inner(A, A) * excess - 0.5 * H * excess**2)


def potential_velocity_equation(V: Jet, grad_U, Q, chi: Jet) -> Float[Array, ""]:
    r"""$(V, \chi) = -(\nabla U, \nabla\chi) + (Q, \chi)$."""
    return V.value * chi.value + inner(grad_U, chi.grad) - Q * chi.value


def potential_normal_equation(rate, g: Jet, hat, grad_U, Q, chi: Jet) -> Float[Array, ""]:
    r"""The normal under $V = \Delta U + Q$, where $g$ is an unknown for $\nabla U$:

    $$ (\partial^\bullet\nu, \chi) = (\nabla g, \nabla\chi) + ((HA - A^2) g, \chi)
       + ((\nabla H\cdot\nabla U)\nu, \chi) + (A^2\nabla U, \chi)
       + 2 (A\nabla U, (\nabla\chi)\nu) + (Q, \nabla\cdot\chi) - (Q H \nu, \chi) $$

    For $U = bH$ with constant $b$ it is (10c). On $\nabla\chi$ see `normal_equation` there.
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


def potential_gradient_equation(g: Jet, nu: Jet, hat, b: Jet, H0: Jet, chi: Jet):
    r"""$g = \nabla U$ without derivatives of $H$, by $\nabla H = \Delta\nu + |A|^2\nu$:

    $$ (g, \chi) = -(\nabla\nu, \nabla(b\chi)) + (b |A|^2 \nu, \chi) - (b \nabla H_0, \chi)
       + ((H - H_0) \nabla b, \chi) $$
    """
    A = weingarten(hat.nu)
    weighted = b.value * chi.grad + jnp.outer(chi.value, b.grad)
    known = (hat.H.value - H0.value) * b.grad - b.value * H0.grad
    return (
        inner(g.value, chi.value)
        + inner(nu.grad, weighted)
        - b.value * inner(A, A) * inner(nu.value, chi.value)
        - inner(known, chi.value)
    )


def gaussian_force_equation(q: Jet, hat, b_k: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$(q, \chi) = -((H I - A) \nabla b_k, \nabla\chi)$."""
    A = weingarten(hat.nu)
    flux = hat.H.value * b_k.grad - A @ b_k.grad
    return q.value * chi.value + inner(flux, chi.grad)


class HelfrichFlow(AbstractFlow):
    r"""Canham–Helfrich flow with parameters that are numbers or fields on the nodes.

    $$ V = \Delta_\Gamma(b (H - H_0)) + |A|^2 b (H - H_0) - \tfrac12 b H (H - H_0)^2
       + \nabla_\Gamma\cdot((H I - A) \nabla_\Gamma b_k) + f, \qquad b = 2 b_b $$

    Unknowns are $H, V, \nu, g$ and, where $b_k$ is a field, $q$. Nodes move with $V\nu$ and carry
    the fields along. The consistency terms are those of `WillmoreFlow`, with the weight
    $\alpha = c \max(b |A_h|^4)$.

    **Arguments:**

    - `bending_modulus`: $b_b$, energy.
    - `spontaneous_curvature`: $H_0$, 1/length, for the sum of the principal curvatures.
    - `gaussian_modulus`: $b_k$, energy. A number does nothing on a closed surface but add
      $2\pi\chi\,b_k$ to the energy.
    - `consistency`, `consistency_weight`, `forcing`: as in `WillmoreFlow`.

    **Raises:** `ValueError` for a modulus that is not positive, a negative `consistency`, or a
    parameter that is not finite; when a run starts, for a field that does not have one number for
    every node, and for an $H_0$ beyond the inverse distance between the nodes.

    *Limits:* jumps in the fields are smeared over a triangle. Inside `MinimalDeformation`, where
    nodes slip past the material, the fields become unknowns.

    ```python
    stiff = 0.5 + 0.2 * x[:, 2]
    flow = jw.flows.HelfrichFlow(stiff, spontaneous_curvature=0.5)
    ```
    """

    # No shape in the annotation: a number, or one for every node, each on its own.
    bending_modulus: Float[Array, "..."]
    spontaneous_curvature: Float[Array, "..."]
    gaussian_modulus: Float[Array, "..."]
    consistency: Float[Array, ""]
    forcing: Callable | None
    consistency_weight: str = eqx.field(static=True)

    evolving: ClassVar[tuple[str, ...]] = ("H", "nu")
    global_names: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self,
        bending_modulus: Any = 0.5,
        spontaneous_curvature: Any = 0.0,
        gaussian_modulus: Any = 0.0,
        consistency=6.0,
        forcing=None,
        consistency_weight="global",
    ):
        self.bending_modulus = positive_field("bending_modulus", bending_modulus)
        self.spontaneous_curvature = finite_field("spontaneous_curvature", spontaneous_curvature)
        self.gaussian_modulus = finite_field("gaussian_modulus", gaussian_modulus)
        self.consistency = non_negative("consistency", consistency)
        self.forcing = forcing
        self.consistency_weight = checked_weight(consistency_weight)

    @property
    def carried(self) -> dict[str, Array]:
        names = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")
        return {name: getattr(self, name) for name in names if getattr(self, name).ndim}

    def with_carried(self, fields):
        names = [name for name in self.carried if name in fields]
        if not names:
            return self
        where = lambda flow: [getattr(flow, name) for name in names]
        return eqx.tree_at(where, self, [fields[name] for name in names])

    @property
    def _has_gaussian_force(self) -> bool:
        return "gaussian_modulus" in self.carried

    @property
    def layout(self) -> Layout:
        if self._has_gaussian_force:
            return Layout(("H", "V", "nu", "g", "q"), (1, 1, 3, 3, 1))
        return Layout(("H", "V", "nu", "g"), (1, 1, 3, 3))

    @property
    def data(self) -> Layout:
        names = ("alpha", "force", "bending_modulus", "spontaneous_curvature")
        names = (*names, "gaussian_modulus") if self._has_gaussian_force else names
        return Layout(names, (1,) * len(names))

    @property
    def stages(self) -> tuple[tuple[str, ...], ...]:
        first = (("q",),) if self._has_gaussian_force else ()
        return (*first, ("nu", "g"), ("H", "V"))

    def equation(self, name, point, rate, hat, trial, data, chi):
        b_b, H0 = data.bending_modulus, data.spontaneous_curvature
        b = Jet(2 * b_b.value, 2 * b_b.grad)
        if name == "H":
            return mean_curvature_equation(rate.H, trial.V, hat, chi) + (
                mean_curvature_consistency(trial.H, trial.nu, data.alpha, chi)
            )
        if name == "g":
            return potential_gradient_equation(trial.g, trial.nu, hat, b, H0, chi)
        if name == "q":
            return gaussian_force_equation(trial.q, hat, data.gaussian_modulus, chi)
        Q = lower_order_force(hat, b, H0) + data.force.value
        if self._has_gaussian_force:
            # An earlier stage has solved for q; its extrapolation is not known in the first step.
            Q = Q + trial.q.value
        if name == "V":
            grad_U = potential_gradient(trial.H, b, H0)
            return potential_velocity_equation(trial.V, grad_U, Q, chi)
        grad_U = potential_gradient(hat.H, b, H0)
        return potential_normal_equation(rate.nu, trial.g, hat, grad_U, Q, chi) + (
            normal_consistency(trial.nu, point, data.alpha, chi)
        )

    def velocity(self, nodal: SimpleNamespace) -> Float[Array, "3"]:
        return nodal.V * nodal.nu

    def closures(self, mesh, t, x, fields, multipliers):
        return jnp.zeros(0)

    def global_scales(self, length):
        return jnp.zeros(0)

    def nodal_data(self, mesh, t, x, fields):
        b_b = on_nodes("bending_modulus", self.bending_modulus, mesh)
        H0 = on_nodes("spontaneous_curvature", self.spontaneous_curvature, mesh)
        curvature = 2 * b_b * nodal_weingarten_squared(mesh, x, fields["nu"]) ** 2
        alpha = consistency_weight(self.consistency_weight, self.consistency, curvature)
        force = jnp.zeros(mesh.n_nodes)
        forcing = self.forcing
        if forcing is not None:
            force = jax.vmap(lambda p: forcing(t, p))(x)
        columns = [alpha, force, b_b, H0]
        if self._has_gaussian_force:
            columns.append(on_nodes("gaussian_modulus", self.gaussian_modulus, mesh))
        return jnp.stack(columns, axis=1)

    def initial_fields(self, mesh, x, given):
        for name in self.carried:
            on_nodes(name, getattr(self, name), mesh)
        check_resolution(jnp.max(jnp.abs(self.spontaneous_curvature)), mesh, x)
        nu = given["nu"] if "nu" in given else recover_normal(mesh, x)
        H = given["H"] if "H" in given else recover_mean_curvature(mesh, x)
        return {"H": H, "nu": nu}

    def energy(self, mesh, x):
        return self._bending_energy()(mesh, x)

    def energy_scale(self, mesh, x):
        return self._bending_energy().scale(mesh, x)

    def _bending_energy(self):
        return CanhamHelfrich(
            self.bending_modulus, self.gaussian_modulus, self.spontaneous_curvature
        )

    def scales(self, length):
        b = 2 * jnp.mean(self.bending_modulus)
        one = jnp.ones(())
        H, V, nu, g = 1 / length, b / length**3, one, b / length**2
        tail = [V] if self._has_gaussian_force else []
        return jnp.stack([H, V, nu, nu, nu, g, g, g, *tail])

    def time_scale(self, length):
        return length**4 / (2 * jnp.mean(self.bending_modulus))

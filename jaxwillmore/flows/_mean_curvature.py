r"""Mean curvature flow and its generalisations $V = -F(H)$, with $H$ and $\nu$ as unknowns."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import non_negative
from ..fem import Jet, Layout, inner
from ..surface import (
    area,
    nodal_weingarten_squared,
    recover_mean_curvature,
    recover_normal,
    weingarten,
)
from ._base import AbstractFlow
from ._consistency import (
    consistency_weight,
    mean_curvature_consistency,
    normal_consistency,
)
from ._willmore import mean_curvature_equation


def speed_equation(V: Jet, F: Float[Array, ""], chi: Jet) -> Float[Array, ""]:
    r"""$(V, \chi) + (F(H), \chi) = 0$."""
    return (V.value + F) * chi.value


def parabolic_normal_equation(rate, nu: Jet, hat, slope, chi: Jet) -> Float[Array, ""]:
    r"""$(\partial^\bullet\nu / F'(H), \chi) + (\nabla\nu, \nabla\chi) - (|A|^2\nu, \chi) = 0$.

    From $\partial^\bullet\nu = -\nabla V = F'(H)\nabla H$ and $\nabla H = \Delta\nu + |A|^2\nu$.
    """
    A = weingarten(hat.nu)
    return (
        inner(rate, chi.value) / slope
        + inner(nu.grad, chi.grad)
        - inner(A, A) * inner(nu.value, chi.value)
    )


def identity(H):
    """$F(H) = H$: mean curvature flow."""
    return H


class MeanCurvatureFlow(AbstractFlow):
    r"""$V = -F(H)$ with increasing $F$; mean curvature flow for $F(H) = H$.

    Inverse mean curvature flow is $F(H) = -1/H$, powers are $F(H) = H^a$, both on surfaces with
    $H > 0$.

    **Arguments:**

    - `speed`: $F$, a function of one number; `None` means $F(H) = H$.
    - `consistency`: factor $c$ of the consistency terms, $\alpha = c\,\max F'(H)|A_h|^2$.

    *Limits:* mean curvature flow of a sphere ends in a point at $t = R^2/4$; stop before.

    **Raises:** `ValueError` for a negative `consistency`.

    ??? cite "Reference"
        Kovács, Li, Lubich (2019), *Numer. Math.* 143, 797–853; Binz, Kovács (2023),
        *IMA J. Numer. Anal.* 43, 2959–3003 (generalised).
    """

    speed: Callable = eqx.field(static=True)
    consistency: Float[Array, ""]

    layout: ClassVar[Layout] = Layout(("H", "V", "nu"), (1, 1, 3))
    evolving: ClassVar[tuple[str, ...]] = ("H", "nu")
    data: ClassVar[Layout] = Layout(("alpha", "force"), (1, 1))
    global_names: ClassVar[tuple[str, ...]] = ()
    stages: ClassVar[tuple[tuple[str, ...], ...]] = (("nu",), ("H", "V"))

    def __init__(self, speed=None, consistency=6.0):
        self.speed = identity if speed is None else speed
        self.consistency = non_negative("consistency", consistency)

    def equation(self, name, point, rate, hat, trial, data, chi):
        force, H = data.force.value, hat.H.value
        F, slope = jax.value_and_grad(self.speed)(H)
        if name == "H":
            return mean_curvature_equation(rate.H, trial.V, hat, chi) + (
                mean_curvature_consistency(trial.H, trial.nu, data.alpha, chi)
            )
        if name == "V":
            # Linear in the trial field, exact when hat and trial agree.
            return speed_equation(trial.V, F + slope * (trial.H.value - H) - force, chi)
        return parabolic_normal_equation(rate.nu, trial.nu, hat, slope, chi) + (
            normal_consistency(trial.nu, point, data.alpha, chi) / slope
        )

    def velocity(self, nodal: SimpleNamespace) -> Float[Array, "3"]:
        return nodal.V * nodal.nu

    def closures(self, mesh, t, x, fields, multipliers):
        return jnp.zeros(0)

    def global_scales(self, length):
        return jnp.zeros(0)

    def nodal_data(self, mesh, t, x, fields):
        A2 = nodal_weingarten_squared(mesh, x, fields["nu"])
        slope = jax.vmap(jax.grad(self.speed))(fields["H"])
        alpha = consistency_weight("global", self.consistency, slope * A2)
        return jnp.stack([alpha, jnp.zeros(mesh.n_nodes)], axis=1)

    def initial_fields(self, mesh, x, given):
        nu = given["nu"] if "nu" in given else recover_normal(mesh, x)
        H = given["H"] if "H" in given else recover_mean_curvature(mesh, x)
        return {"H": H, "nu": nu}

    def with_carried(self, fields):
        return self

    def energy(self, mesh, x):
        return area(mesh, x)

    def energy_scale(self, mesh, x):
        return area(mesh, x)

    def scales(self, length):
        one = jnp.ones(())
        V = length / self.time_scale(length)
        return jnp.stack([1 / length, V, one, one, one])

    def time_scale(self, length):
        slope = jnp.abs(jax.grad(self.speed)(2 / length))
        return length**2 / slope

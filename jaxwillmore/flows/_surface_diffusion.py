r"""Surface diffusion $V = \Delta_\Gamma H$: the volume stays, the area falls."""

from types import SimpleNamespace
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import non_negative, positive
from ..fem import Layout
from ..surface import area, nodal_weingarten_squared, recover_mean_curvature, recover_normal
from ._base import AbstractFlow
from ._consistency import (
    consistency_weight,
    mean_curvature_consistency,
    normal_consistency,
)
from ._willmore import (
    auxiliary_normal_equation,
    mean_curvature_equation,
    normal_equation,
    normal_velocity_equation,
)


class SurfaceDiffusion(AbstractFlow):
    r"""$V = m\,\Delta_\Gamma H$, the H⁻¹ gradient flow of the area: (10a)–(10e) with $Q = 0$.

    **Arguments:**

    - `mobility`: $m$, length⁴/time.
    - `consistency`: factor $c$ of the consistency terms, $\alpha = c\,m\,\max|A_h|^4$.

    **Raises:** `ValueError` for a mobility that is not positive or a negative `consistency`.

    ??? cite "Reference"
        Kovács, Li, Lubich (2021), *Numer. Math.* 149, 595–643, section 7 (Q = 0).
    """

    mobility: Float[Array, ""]
    consistency: Float[Array, ""]

    layout: ClassVar[Layout] = Layout(("H", "V", "nu", "z"), (1, 1, 3, 3))
    evolving: ClassVar[tuple[str, ...]] = ("H", "nu")
    data: ClassVar[Layout] = Layout(("alpha", "force"), (1, 1))
    global_names: ClassVar[tuple[str, ...]] = ()
    stages: ClassVar[tuple[tuple[str, ...], ...]] = (("nu", "z"), ("H", "V"))

    def __init__(self, mobility=1.0, consistency=6.0):
        self.mobility = positive("mobility", mobility)
        self.consistency = non_negative("consistency", consistency)

    def equation(self, name, point, rate, hat, trial, data, chi):
        m, Q = self.mobility, data.force.value
        if name == "H":
            return mean_curvature_equation(rate.H, trial.V, hat, chi) + (
                mean_curvature_consistency(trial.H, trial.nu, data.alpha, chi)
            )
        if name == "V":
            return normal_velocity_equation(trial.V, trial.H, m, Q, chi)
        if name == "nu":
            return normal_equation(rate.nu, trial.z, hat, m, Q, chi) + (
                normal_consistency(trial.nu, point, data.alpha, chi)
            )
        return auxiliary_normal_equation(trial.z, trial.nu, hat, chi)

    def velocity(self, nodal: SimpleNamespace) -> Float[Array, "3"]:
        return nodal.V * nodal.nu

    def closures(self, mesh, t, x, fields, multipliers):
        return jnp.zeros(0)

    def global_scales(self, length):
        return jnp.zeros(0)

    def nodal_data(self, mesh, t, x, fields):
        A2 = nodal_weingarten_squared(mesh, x, fields["nu"])
        alpha = consistency_weight("global", self.consistency * self.mobility, A2**2)
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
        H, V, nu, z = 1 / length, self.mobility / length**3, one, 1 / length**2
        return jnp.stack([H, V, nu, nu, nu, z, z, z])

    def time_scale(self, length):
        return length**4 / self.mobility

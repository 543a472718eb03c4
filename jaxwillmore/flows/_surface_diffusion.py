r"""Surface diffusion $V = \Delta_\Gamma H$: the volume stays, the area falls."""

from jaxtyping import Array, Float

from ..energies import SurfaceTension, non_negative, positive
from ..fem import Jet
from ..surface import nodal_weingarten_squared
from ._consistency import (
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
from ._willmore import (
    auxiliary_normal_equation,
    mean_curvature_equation,
    normal_equation,
    normal_velocity_equation,
)


class SurfaceDiffusion(AbstractLaw):
    r"""$V = m\,\Delta_\Gamma H$, the H⁻¹ gradient flow of the area: (10a)–(10e) with $Q = 0$.

    **Arguments:**

    - `mullins_coefficient`: $m$, length⁴/time.
    - `consistency`: factor $c$ of the consistency terms, $\alpha = c\,m\,\max|A_h|^4$.

    **Raises:** `ValueError` for a coefficient that is not positive or a negative `consistency`.

    ??? cite "Reference"
        Kovács, Li, Lubich (2021), *Numer. Math.* 149, 595–643, section 7 (Q = 0).
    """

    mullins_coefficient: Float[Array, ""]
    consistency: Float[Array, ""]

    def __init__(self, mullins_coefficient=1.0, consistency=6.0):
        self.mullins_coefficient = positive("mullins_coefficient", mullins_coefficient)
        self.consistency = non_negative("consistency", consistency)

    def statement(self):
        def time(length):
            return length**4 / self.mullins_coefficient

        fields = geometric_fields(self._mean_curvature, self._velocity, self._normal, time)
        z = Field("z", self._auxiliary_normal, lambda u: 1 / u.length**2, components=3)
        return Statement(
            fields=(*fields, z),
            stages=(("nu", "z"), ("H", "V")),
            start=recovered_geometry,
            velocity=normal_motion,
            data={"alpha": self._weight},
            energy=SurfaceTension(1.0),
            length_time=time,
            record=geometry_record,
            activity=speed_at_rest(time),
        )

    def _mean_curvature(self, s: Local, chi: Jet):
        return mean_curvature_equation(s.rate.H, s.trial.V, s.hat, chi) + (
            mean_curvature_consistency(s.trial.H, s.trial.nu, s.data.alpha, chi)
        )

    def _velocity(self, s: Local, chi: Jet):
        return normal_velocity_equation(
            s.trial.V, s.trial.H, self.mullins_coefficient, s.force(), chi
        )

    def _normal(self, s: Local, chi: Jet):
        return normal_equation(
            s.rate.nu, s.trial.z, s.hat, self.mullins_coefficient, s.force(), chi
        ) + (normal_consistency(s.trial.nu, s.point, s.data.alpha, chi))

    def _auxiliary_normal(self, s: Local, chi: Jet):
        return auxiliary_normal_equation(s.trial.z, s.trial.nu, s.hat, chi)

    def _weight(self, s):
        A2 = nodal_weingarten_squared(s.mesh, s.x, s.fields["nu"])
        return consistency_weight("global", self.consistency * self.mullins_coefficient, A2**2)

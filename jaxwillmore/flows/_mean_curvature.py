r"""Mean curvature flow and its generalisations $V = -F(H)$, with $H$ and $\nu$ as unknowns."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._functions import as_data
from ..energies import SurfaceTension, non_negative
from ..fem import Jet, inner
from ..surface import nodal_weingarten_squared, weingarten
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
from ._law import AbstractLaw, Local, Statement
from ._willmore import mean_curvature_equation

# Mean curvatures at which the sign of F decides whether the law shrinks the area.
SAMPLES = np.array([0.01, 0.1, 1.0, 10.0, 100.0])


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


class MeanCurvatureFlow(AbstractLaw):
    r"""$V = -F(H)$ with increasing $F$; mean curvature flow for $F(H) = H$.

    Inverse mean curvature flow is $F(H) = -1/H$, powers are $F(H) = H^a$, both on surfaces with
    $H > 0$.

    **Arguments:**

    - `speed`: $F$, a function of one number; `None` means $F(H) = H$.
    - `consistency`: factor $c$ of the consistency terms, $\alpha = c\,\max F'(H)|A_h|^2$.

    The area falls where $F(H) H \ge 0$; a law with $F < 0$ somewhere on $H > 0$, such as inverse
    mean curvature flow, lowers no energy, and steps are not rejected for a rise of the area.

    *Limits:* mean curvature flow of a sphere ends in a point at $t = R^2/4$; stop before.

    **Raises:** `ValueError` for a negative `consistency`.

    ??? cite "Reference"
        Kovács, Li, Lubich (2019), *Numer. Math.* 143, 797–853; Binz, Kovács (2022),
        *IMA J. Numer. Anal.* 42, 2545–2588, arXiv 2010.11044 (generalised).
    """

    speed: Callable
    consistency: Float[Array, ""]

    def __init__(self, speed=None, consistency=6.0):
        self.speed = identity if speed is None else as_data(speed)
        self.consistency = non_negative("consistency", consistency)

    def statement(self):
        def time(length):
            return length**2 / jnp.abs(jax.grad(self.speed)(2 / length))

        return Statement(
            fields=geometric_fields(self._mean_curvature, self._velocity, self._normal, time),
            stages=(("nu",), ("H", "V")),
            start=recovered_geometry,
            velocity=normal_motion,
            data={"alpha": self._weight},
            energy=SurfaceTension(1.0),
            lowers_energy=self._shrinks(),
            length_time=time,
            record=geometry_record,
            activity=speed_at_rest(time),
        )

    def _shrinks(self) -> bool:
        if self.speed is identity:
            return True
        with jax.ensure_compile_time_eval():
            values = [self.speed(jnp.asarray(H)) for H in SAMPLES]
        # Where a parameter of F is traced nothing is known, and nothing is rejected either.
        return all(not isinstance(F, Tracer) and float(F) >= 0 for F in values)

    def _mean_curvature(self, s: Local, chi: Jet):
        return mean_curvature_equation(s.rate.H, s.trial.V, s.hat, chi) + (
            mean_curvature_consistency(s.trial.H, s.trial.nu, s.data.alpha, chi)
        )

    def _velocity(self, s: Local, chi: Jet):
        H = s.hat.H.value
        F, slope = jax.value_and_grad(self.speed)(H)
        # Linear in the trial field, exact when hat and trial agree.
        return speed_equation(s.trial.V, F + slope * (s.trial.H.value - H) - s.force(), chi)

    def _normal(self, s: Local, chi: Jet):
        slope = jax.grad(self.speed)(s.hat.H.value)
        return parabolic_normal_equation(s.rate.nu, s.trial.nu, s.hat, slope, chi) + (
            normal_consistency(s.trial.nu, s.point, s.data.alpha, chi) / slope
        )

    def _weight(self, s):
        A2 = nodal_weingarten_squared(s.mesh, s.x, s.fields["nu"])
        slope = jax.vmap(jax.grad(self.speed))(s.fields["H"])
        return consistency_weight("global", self.consistency, slope * A2)

r"""Mean curvature flow with diffusion: the gradient flow of $\int G(u)$ for a conserved density.

For the energy $\int G(u)$ of a density $u$ whose amount stays,

$$ V = -g(u) H, \quad g = G - G' u, \qquad
   \partial^\bullet u = -uHV + \nabla_\Gamma\cdot(\mathcal D(u)\nabla_\Gamma u), \quad
   \mathcal D = G'' $$

lower it: a surface tension $g$ that depends on a surfactant, which diffuses.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._functions import as_data
from ..energies import FreeEnergy, non_negative
from ..fem import Jet, inner
from ..phases import amount
from ..surface import nodal_weingarten_squared
from . import _geometry as surface
from ._consistency import consistency_weight, mean_curvature_consistency, normal_consistency
from ._law import AbstractLaw, Field, Local, Statement
from ._mean_curvature import parabolic_normal_equation, speed_equation
from ._willmore import mean_curvature_equation


class CurvatureDiffusion(AbstractLaw):
    r"""$V = -g(u)H$ with a density $u$ that the surface carries and that diffuses.

    **Arguments:**

    - `density`: $G$, energy/length², a function of $u$ with $g = G - G'u > 0$ and $G'' > 0$; give
      an `eqx.Module` to keep its parameters differentiable.
    - `consistency`: factor $c$ of the consistency terms, $\alpha = c\,\max g|A_h|^2$.

    The start needs `initial={"u": ...}`.

    *Limits:* a sphere shrinks to the radius at which $g$ vanishes, or to a point; stop before.

    **Raises:** `ValueError` for a negative `consistency`, and without a start for $u$.

    ??? cite "Reference"
        Elliott, Garcke, Kovács (2022), *Numer. Math.* 151, 873–925, equations (1.1)–(1.3).
    """

    density: Callable[[Float[Array, ""]], Float[Array, ""]]
    consistency: Float[Array, ""]

    def __init__(self, density, consistency=6.0):
        self.density = as_data(density)
        self.consistency = non_negative("consistency", consistency)

    def statement(self):
        time = lambda length: length**2 / self._size()
        one = lambda _: jnp.ones(())
        u = Field("u", self._diffusion, one, role="conserved", error_weight=0.05)
        fields = surface.geometric_fields(self._mean_curvature, self._velocity, self._normal, time)
        return Statement(
            fields=(u, *fields),
            stages=(("u",), ("nu",), ("H", "V")),
            start=self._start,
            velocity=surface.normal_motion,
            data={"alpha": self._weight},
            energy=FreeEnergy(self.density),
            length_time=time,
            record=lambda s: (
                surface.geometry_record(s) | {"amount": amount(s.mesh, s.x, s.fields["u"])}
            ),
            activity=surface.speed_at_rest(time),
            implicit_only=True,
        )

    def _size(self):
        r"""Typical tension: $|g| + u^2 |G''|$ at u = 1, since g alone may vanish there."""
        u = jnp.ones(())
        return jnp.abs(self.tension(u)) + jnp.abs(jax.grad(jax.grad(self.density))(u))

    def tension(self, u) -> Float[Array, ""]:
        r"""$g = G - G'u$."""
        G, slope = jax.value_and_grad(self.density)(u)
        return G - slope * u

    def _diffusion(self, s: Local, chi: Jet):
        r"""$\mathrm d(u, \chi)/\mathrm dt = -(\mathcal D\nabla u, \nabla\chi)$."""
        D = jax.grad(jax.grad(self.density))(s.trial.u.value)
        return s.rate.u * chi.value + D * inner(s.trial.u.grad, chi.grad)

    def _mean_curvature(self, s: Local, chi: Jet):
        return mean_curvature_equation(s.rate.H, s.trial.V, s.hat, chi) + (
            mean_curvature_consistency(s.trial.H, s.trial.nu, s.data.alpha, chi)
        )

    def _velocity(self, s: Local, chi: Jet):
        F = self.tension(s.hat.u.value) * s.trial.H.value
        return speed_equation(s.trial.V, F - s.force(), chi)

    def _normal(self, s: Local, chi: Jet):
        r"""$(\partial^\bullet\nu/g, \chi) + (\nabla\nu, \nabla\chi) = (|A|^2\nu + H (g'/g)\nabla u,
        \chi)$."""
        u, H = s.hat.u, s.hat.H.value
        g, slope = jax.value_and_grad(self.tension)(u.value)
        return (
            parabolic_normal_equation(s.rate.nu, s.trial.nu, s.hat, g, chi)
            - H * slope / g * inner(u.grad, chi.value)
            + normal_consistency(s.trial.nu, s.point, s.data.alpha, chi) / g
        )

    def _weight(self, s):
        A2 = nodal_weingarten_squared(s.mesh, s.x, s.fields["nu"])
        g = jax.vmap(self.tension)(s.fields["u"])
        return consistency_weight("global", self.consistency, g * A2)

    def _start(self, mesh, x, given):
        if "u" not in given:
            raise ValueError('The density needs a start: initial={"u": ...}, one for every node.')
        return {"u": given["u"]} | surface.recovered_geometry(mesh, x, given)

"""Tension, pressure, osmosis, external potentials and exact constraints."""

from collections.abc import Callable
from typing import TypeGuard

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from .._functions import as_data
from ..energies import AbstractEnergy, AbstractGlobalEnergy, ExternalPotential, terms_of
from ..fem import inner, integrate, trace
from ..surface import area, volume
from ._law import AbstractLaw, Globals, Local, Statement, Units, Whole


class Loads(AbstractLaw):
    r"""Forces from outside, of the surface as a whole, or such that hold area and volume.

    The normal force is $-\sigma H + P - 2 m K$ with the tension $\sigma$, the pressure $P$ (inside
    minus outside; positive inflates) and the curvature multiplier $m$ of $\int H$. All three are
    unknowns of every step. For an energy $f(A, V_p, M)$ of area, volume and $M = \int H$ they are
    its partial derivatives,

    $$ \sigma = \partial_A f, \qquad P = -\partial_V f, \qquad m = \partial_M f; $$

    where area or volume are prescribed, $\sigma$ or $P$ is the Lagrange multiplier instead, and the
    prescribed value holds to rounding at every step. A potential $\phi$ in space adds
    $-(\phi H + \partial_\nu\phi)$.

    **Arguments:**

    - `energy`: a global energy (`SurfaceTension`, `OsmoticPressure`, ...), an `ExternalPotential`,
      a sum of them, or `None`.
    - `area`: the area to hold, or a function of time; `None` leaves it free.
    - `volume`: the enclosed volume to hold, or a function of time; `None` leaves it free.

    A value that changes in time does work: the energy may rise, and steps are not rejected for it.

    **Raises:** `ValueError` for an energy that is none of these, for a prescribed area or volume
    that is not positive, or for a pair that no surface has (reduced volume above 1).
    """

    energy: AbstractEnergy | None
    area: Float[Array, ""] | Callable | None
    volume: Float[Array, ""] | Callable | None

    def __init__(self, energy=None, *, area=None, volume=None):
        for _, term in [] if energy is None else terms_of(energy):
            if not isinstance(term, AbstractGlobalEnergy | ExternalPotential):
                raise ValueError(
                    "`energy` must be a sum of global energies and external potentials; "
                    f"{type(term).__name__} is local and belongs into a law of its own."
                )
        self.energy = energy
        self.area, self.volume = _target("area", area), _target("volume", volume)
        A, V = self.area, self.volume
        if _is_known(A) and _is_known(V):
            v = 6 * jnp.sqrt(jnp.pi) * V / A**1.5
            if v > 1:
                raise ValueError(
                    f"No surface of area {float(A):.6g} encloses the volume {float(V):.6g}: the "
                    f"reduced volume would be {float(v):.6g}, and 1 (the sphere) is the largest "
                    "possible."
                )

    def statement(self):
        names = ("tension", "pressure", "curvature_multiplier")
        return Statement(
            reads=("H", "nu"),
            force=self._force,
            globals=Globals(names, self._closures, self._scales),
            energy=self.energy,
            lowers_energy=not (callable(self.area) or callable(self.volume)),
        )

    def _terms(self):
        return [] if self.energy is None else terms_of(self.energy)

    def _force(self, s: Local):
        m, A, H = s.multipliers, s.A, s.hat.H.value
        twice_K = trace(A) ** 2 - inner(A, A)
        force = -m.tension * H + m.pressure - m.curvature_multiplier * twice_K
        for factor, term in self._terms():
            if isinstance(term, ExternalPotential):
                phi, slope = jax.value_and_grad(term.potential)(s.point.position)
                force -= factor * (phi * H + inner(slope, s.hat.nu.value))
        return force

    def _closures(self, s: Whole):
        m, A, V = s.multipliers, area(s.mesh, s.x), volume(s.mesh, s.x)
        scales = jax.lax.stop_gradient(self._scales(s.units))
        M = integrate(s.mesh, s.x, lambda _, f: f.H.value, {"H": s.fields["H"]})
        slopes = jax.grad(self._global_energy, argnums=(0, 1, 2))(A, V, M)
        rows = [
            (m.tension - slopes[0]) / scales[0],
            (m.pressure + slopes[1]) / scales[1],
            (m.curvature_multiplier - slopes[2]) / scales[2],
        ]
        if self.area is not None:
            rows[0] = A / _at(self.area, s.t) - 1
        if self.volume is not None:
            rows[1] = V / _at(self.volume, s.t) - 1
        return jnp.stack(rows)

    def _global_energy(self, A, V, M):
        total = jnp.zeros(())
        for factor, term in self._terms():
            if isinstance(term, AbstractGlobalEnergy):
                total += factor * term.of(A, V, M)
        return total

    def _scales(self, u: Units):
        return u.velocity * jnp.stack([u.length, jnp.ones(()), u.length**2])


def _target(name: str, value):
    if value is None or callable(value):
        return value if value is None else as_data(value)
    value = jnp.asarray(value, float)
    if not isinstance(value, Tracer) and not (jnp.isfinite(value) and value > 0):
        raise ValueError(f"`{name}` must be positive; got {float(value)}.")
    return value


def _is_known(target) -> TypeGuard[Array]:
    return eqx.is_array(target) and not isinstance(target, Tracer)


def _at(target, t):
    return target(t) if callable(target) else target

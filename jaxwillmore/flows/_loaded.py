"""Tension, pressure, osmosis, external potentials and exact constraints on top of a flow."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import TypeGuard

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from ..energies import AbstractEnergy, AbstractGlobalEnergy, ExternalPotential, terms_of
from ..fem import Jet, inner, integrate, trace
from ..surface import area, volume, weingarten
from ._base import AbstractFlow


class Loaded(AbstractFlow):
    r"""A flow with forces from outside, of the surface as a whole, or to hold area and volume.

    The law becomes $V = \dots - \sigma H + P - 2 m K$ with the tension $\sigma$, the pressure $P$
    (inside minus outside; positive inflates) and the curvature multiplier $m$ of $\int H$. All
    three are unknowns of the Newton system of every step. For an energy $f(A, V_p, M)$ of area,
    volume and $M = \int H$ they are its partial derivatives,

    $$ \sigma = \partial_A f, \qquad P = -\partial_V f, \qquad m = \partial_M f; $$

    where area or volume are prescribed, $\sigma$ or $P$ is the Lagrange multiplier instead, and the
    prescribed value holds to rounding at every step. A potential $\phi$ in space adds
    $-(\phi H + \partial_\nu\phi)$.

    **Arguments:**

    - `flow`: the flow of the bending energy.
    - `energy`: a global energy (`SurfaceTension`, `OsmoticPressure`, ...), an `ExternalPotential`,
      a sum of them, or `None`.
    - `fixed_area`: the area, or a function of time; `None` leaves it free.
    - `fixed_volume`: the enclosed volume, or a function of time; `None` leaves it free.

    **Raises:** `ValueError` for an energy that is none of these, for a prescribed area or volume
    that is not positive, or for a pair that no surface has (reduced volume above 1).
    """

    flow: AbstractFlow
    load_energy: AbstractEnergy | None
    fixed_area: Float[Array, ""] | Callable | None
    fixed_volume: Float[Array, ""] | Callable | None

    def __init__(self, flow, energy=None, *, fixed_area=None, fixed_volume=None):
        for _, term in [] if energy is None else terms_of(energy):
            if not isinstance(term, AbstractGlobalEnergy | ExternalPotential):
                raise ValueError(
                    "`energy` must be a sum of global energies and external potentials; "
                    f"{type(term).__name__} is local and belongs into the flow."
                )
        self.flow, self.load_energy = flow, energy
        self.fixed_area = _target("fixed_area", fixed_area)
        self.fixed_volume = _target("fixed_volume", fixed_volume)
        A, V = self.fixed_area, self.fixed_volume
        if _is_known(A) and _is_known(V):
            v = 6 * jnp.sqrt(jnp.pi) * V / A**1.5
            if v > 1:
                raise ValueError(
                    f"No surface of area {float(A):.6g} encloses the volume {float(V):.6g}: the "
                    f"reduced volume would be {float(v):.6g}, and 1 (the sphere) is the largest "
                    "possible."
                )

    @property
    def layout(self):
        return self.flow.layout

    @property
    def evolving(self):
        return self.flow.evolving

    @property
    def data(self):
        return self.flow.data

    @property
    def stages(self):
        return self.flow.stages

    @property
    def carried(self):
        return self.flow.carried

    @property
    def global_names(self) -> tuple[str, ...]:
        return ("tension", "pressure", "curvature_multiplier")

    def equation(self, name, point, rate, hat, trial, data, chi):
        sigma, P, m = data.multipliers
        A, H = weingarten(hat.nu), hat.H.value
        twice_K = trace(A) ** 2 - inner(A, A)
        load = -sigma * H + P - m * twice_K + self._external_force(point.position, hat)
        force = Jet(data.force.value + load, data.force.grad)
        loaded = SimpleNamespace(**{**vars(data), "force": force})
        return self.flow.equation(name, point, rate, hat, trial, loaded, chi)

    def _terms(self):
        return [] if self.load_energy is None else terms_of(self.load_energy)

    def _external_force(self, position, hat):
        force = jnp.zeros(())
        for factor, term in self._terms():
            if isinstance(term, ExternalPotential):
                phi, slope = jax.value_and_grad(term.potential)(position)
                force -= factor * (phi * hat.H.value + inner(slope, hat.nu.value))
        return force

    def velocity(self, nodal):
        return self.flow.velocity(nodal)

    def closures(self, mesh, t, x, fields, multipliers):
        sigma, P, m = multipliers
        A, V = area(mesh, x), volume(mesh, x)
        length = jnp.sqrt(A / (4 * jnp.pi))
        scales = jax.lax.stop_gradient(self.global_scales(length))
        M = integrate(mesh, x, lambda _, f: f.H.value, {"H": fields["H"]})
        slopes = jax.grad(self._global_energy, argnums=(0, 1, 2))(A, V, M)
        rows = [
            (sigma - slopes[0]) / scales[0],
            (P + slopes[1]) / scales[1],
            (m - slopes[2]) / scales[2],
        ]
        if self.fixed_area is not None:
            rows[0] = A / _at(self.fixed_area, t) - 1
        if self.fixed_volume is not None:
            rows[1] = V / _at(self.fixed_volume, t) - 1
        return jnp.stack(rows)

    def _global_energy(self, A, V, M):
        total = jnp.zeros(())
        for factor, term in self._terms():
            if isinstance(term, AbstractGlobalEnergy):
                total += factor * term.of(A, V, M)
        return total

    def global_scales(self, length):
        force = length / self.flow.time_scale(length)
        return jnp.stack([force * length, force, force * length**2])

    def nodal_data(self, mesh, t, x, fields):
        return self.flow.nodal_data(mesh, t, x, fields)

    def initial_fields(self, mesh, x, given):
        return self.flow.initial_fields(mesh, x, given)

    def with_carried(self, fields):
        return eqx.tree_at(lambda f: f.flow, self, self.flow.with_carried(fields))

    def energy(self, mesh, x):
        total = self.flow.energy(mesh, x)
        return total if self.load_energy is None else total + self.load_energy(mesh, x)

    def energy_scale(self, mesh, x):
        total = self.flow.energy_scale(mesh, x)
        for factor, term in self._terms():
            total += jnp.abs(factor * term(mesh, x))
        return total

    def scales(self, length):
        return self.flow.scales(length)

    def time_scale(self, length):
        return self.flow.time_scale(length)


def _target(name: str, value):
    if value is None or callable(value):
        return value
    value = jnp.asarray(value, float)
    if not isinstance(value, Tracer) and not (jnp.isfinite(value) and value > 0):
        raise ValueError(f"`{name}` must be positive; got {float(value)}.")
    return value


def _is_known(target) -> TypeGuard[Array]:
    return eqx.is_array(target) and not isinstance(target, Tracer)


def _at(target, t):
    return target(t) if callable(target) else target

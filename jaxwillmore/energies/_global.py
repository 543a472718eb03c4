r"""Energies of area, volume and total mean curvature.

Their first variation needs no weak form: with $\partial A = \int HV$, $\partial V_p = \int V$ and
$\partial M = \int 2KV$ it follows from the partial derivatives of a function of three numbers.
"""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import integrate
from ..surface import area, mean_curvature_vector, volume
from ._base import AbstractEnergy
from ._parameters import finite, nodes_of, positive


class AbstractGlobalEnergy(AbstractEnergy):
    r"""An energy $f(A, V_p, M)$ of area, enclosed volume and $M = \int H$."""

    @abc.abstractmethod
    def of(
        self, A: Float[Array, ""], V_p: Float[Array, ""], M: Float[Array, ""]
    ) -> Float[Array, ""]:
        """The energy from area, volume and total mean curvature."""

    def __call__(self, mesh, x, fields=None):
        x = nodes_of(mesh, x)
        Y = mean_curvature_vector(mesh, x)
        M = integrate(mesh, x, lambda p, f: jnp.sum(f.Y.value * p.normal), {"Y": Y})
        return self.of(area(mesh, x), volume(mesh, x), M)


class SurfaceTension(AbstractGlobalEnergy):
    r"""$\sigma A$; `surface_tension` in energy/length²."""

    surface_tension: Float[Array, ""]

    def __init__(self, surface_tension):
        self.surface_tension = finite("surface_tension", surface_tension)

    def of(self, A, V_p, M):
        return self.surface_tension * A


class Pressure(AbstractGlobalEnergy):
    r"""$-P V_p$ with $P = P_{in} - P_{out}$; `pressure_difference` in energy/length³."""

    pressure_difference: Float[Array, ""]

    def __init__(self, pressure_difference):
        self.pressure_difference = finite("pressure_difference", pressure_difference)

    def of(self, A, V_p, M):
        return -self.pressure_difference * V_p


class OsmoticPressure(AbstractGlobalEnergy):
    r"""van 't Hoff: $E = iRTn\,(r - \ln r - 1)$ with $r = \bar c V_p / n$.

    The pressure is $-\partial E/\partial V_p = iRT\,(n/V_p - \bar c)$; it vanishes, as the energy
    does, at $V_p = n/\bar c$.

    **Arguments:**

    - `solute_amount`: $n$, amount inside.
    - `ambient_concentration`: $\bar c$, amount/length³.
    - `temperature`: $T$.
    - `gas_constant`: $R$; the default is 8.3145e-3 nN µm/(K amol), for lengths in µm, forces in nN
      and amounts in amol. With 1 and `temperature` 1 the product $RT$ is the unit of energy.
    - `vant_hoff_index`: $i$, particles per formula unit.

    **Raises:** `ValueError` unless all are positive.
    """

    solute_amount: Float[Array, ""]
    ambient_concentration: Float[Array, ""]
    temperature: Float[Array, ""]
    gas_constant: Float[Array, ""]
    vant_hoff_index: Float[Array, ""]

    def __init__(
        self,
        solute_amount,
        ambient_concentration,
        temperature=298.15,
        gas_constant=8.3145e-3,
        vant_hoff_index=1.0,
    ):
        self.solute_amount = positive("solute_amount", solute_amount)
        self.ambient_concentration = positive("ambient_concentration", ambient_concentration)
        self.temperature = positive("temperature", temperature)
        self.gas_constant = positive("gas_constant", gas_constant)
        self.vant_hoff_index = positive("vant_hoff_index", vant_hoff_index)

    def of(self, A, V_p, M):
        n = self.solute_amount
        r = self.ambient_concentration * V_p / n
        iRT = self.vant_hoff_index * self.gas_constant * self.temperature
        return iRT * n * (r - jnp.log(r) - 1)


class AreaPenalty(AbstractGlobalEnergy):
    r"""$\tfrac12 K_A (A - \bar A)^2 / \bar A$; `stretching_modulus` in energy/length²."""

    stretching_modulus: Float[Array, ""]
    preferred_area: Float[Array, ""]

    def __init__(self, stretching_modulus, preferred_area):
        self.stretching_modulus = positive("stretching_modulus", stretching_modulus)
        self.preferred_area = positive("preferred_area", preferred_area)

    def of(self, A, V_p, M):
        return 0.5 * self.stretching_modulus * (A - self.preferred_area) ** 2 / self.preferred_area


class VolumePenalty(AbstractGlobalEnergy):
    r"""$\tfrac12 K_V ((V_p - \bar V)/\bar V)^2$; `strength` in energy."""

    strength: Float[Array, ""]
    preferred_volume: Float[Array, ""]

    def __init__(self, strength, preferred_volume):
        self.strength = positive("strength", strength)
        self.preferred_volume = positive("preferred_volume", preferred_volume)

    def of(self, A, V_p, M):
        return 0.5 * self.strength * (V_p / self.preferred_volume - 1) ** 2


class AreaDifference(AbstractGlobalEnergy):
    r"""Area-difference elasticity $\tfrac{\kappa_r}{2}\tfrac{\pi}{A D^2} (D M - \Delta A_0)^2$.

    **Arguments:**

    - `nonlocal_modulus`: $\kappa_r$, energy.
    - `preferred_difference`: $\Delta A_0$, area of the outer minus that of the inner leaflet.
    - `thickness`: $D$, distance of the leaflets; $\Delta A = D\int H$.
    """

    nonlocal_modulus: Float[Array, ""]
    preferred_difference: Float[Array, ""]
    thickness: Float[Array, ""]

    def __init__(self, nonlocal_modulus, preferred_difference, thickness):
        self.nonlocal_modulus = positive("nonlocal_modulus", nonlocal_modulus)
        self.preferred_difference = finite("preferred_difference", preferred_difference)
        self.thickness = positive("thickness", thickness)

    def of(self, A, V_p, M):
        excess = self.thickness * M - self.preferred_difference
        return 0.5 * self.nonlocal_modulus * jnp.pi / (A * self.thickness**2) * excess**2

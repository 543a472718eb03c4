"""Equilibrium: what was found, and the differentiable function that finds it again."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ..mesh import SurfaceMesh
from ._diagnostics import MeshHealth, mesh_health
from ._functional import (
    EquilibriumSystem,
    Parameters,
    Path,
    Reference,
    Units,
    area_and_volume,
)
from ._results import RESULTS
from ._solve import Solved, newton
from ._stability import lowest_modes

N_MODES = 8


class Equilibrium(eqx.Module):
    r"""A stationary shape of the bending energy under constraints.

    **Attributes:**

    - `mesh`, `x`: the shape.
    - `Y`: nodal field $2 b_b (H - H_0)\nu$, the moment that is in equilibrium.
    - `energy`: $b_b\int (H - H_0)^2$, by the mixed functional.
    - `tension`, `pressure`: $\sigma$ and $P = P_{in} - P_{out}$, multipliers or prescribed.
    - `parameters`: all parameters at the solution, area and volume included.
    - `residual`: largest entry of the dimensionless equations.
    - `negative_directions`: of the constrained second variation, rigid motions excluded; 0 for a
      stable shape, `None` if not asked for.
    - `eigenvalues`: the lowest ones of that variation, in units of $\kappa/R_0^4$.
    - `reference`, `units`, `unknowns`: the frozen problem that `resolve` solves again.
    - `result`, `stats`: how it ended and what it cost.
    """

    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]
    Y: Float[Array, "nodes 3"]
    energy: Float[Array, ""]
    tension: Float[Array, ""]
    pressure: Float[Array, ""]
    parameters: Parameters
    residual: float
    negative_directions: int | None
    eigenvalues: tuple[float, ...]
    result: RESULTS
    reference: Reference
    units: Units
    unknowns: Float[Array, " unknowns"]
    fixed_area: bool
    fixed_volume: bool
    stats: dict[str, Any]

    @property
    def reduced_volume(self) -> Float[Array, ""]:
        r"""$v = 6\sqrt\pi\,V_p/|\Gamma|^{3/2}$."""
        return 6 * jnp.sqrt(jnp.pi) * self.parameters.volume / self.parameters.area**1.5

    @property
    def area_radius(self) -> Float[Array, ""]:
        r"""$R_0 = \sqrt{|\Gamma|/4\pi}$."""
        return jnp.sqrt(self.parameters.area / (4 * jnp.pi))

    @property
    def bending_over_8pi_kappa(self) -> Float[Array, ""]:
        r"""$E/(8\pi\kappa)$ with $\kappa = 2 b_b$: 1 for a sphere at $H_0 = 0$."""
        return self.energy / (16 * jnp.pi * self.parameters.bending_modulus)

    @property
    def scaled_tension(self) -> Float[Array, ""]:
        r"""$\sigma R_0^2/\kappa$."""
        return self.tension * self.area_radius**2 / (2 * self.parameters.bending_modulus)

    @property
    def scaled_pressure(self) -> Float[Array, ""]:
        r"""$P R_0^3/\kappa$."""
        return self.pressure * self.area_radius**3 / (2 * self.parameters.bending_modulus)

    @property
    def health(self) -> MeshHealth:
        """Worst angle, mid-node offset and area element of the mesh."""
        return mesh_health(self.mesh, self.x)

    @property
    def succeeded(self) -> bool:
        """Whether the shape is stationary to the tolerance."""
        return bool(self.result == RESULTS.converged)


def constant_path(r: Reference) -> Path:
    """No path: the extra unknown is zero."""
    zero = jnp.zeros(())
    nothing = Parameters(zero, zero, zero, zero, zero, zero)
    return Path(nothing, jnp.zeros(r.X.shape[0]), jnp.ones(()), zero)


class Resolved(eqx.Module):
    """An equilibrium on a frozen reference, as a differentiable function of its parameters."""

    x: Float[Array, "nodes 3"]
    Y: Float[Array, "nodes 3"]
    energy: Float[Array, ""]
    tension: Float[Array, ""]
    pressure: Float[Array, ""]
    area: Float[Array, ""]
    volume: Float[Array, ""]
    converged: Bool[Array, ""]


def resolve(
    equilibrium: Equilibrium,
    parameters: Parameters,
    *,
    tolerance: float = 1e-10,
    linear_solver: str = "direct",
) -> Resolved:
    r"""Solve again for other parameters on the reference surface of an equilibrium.

    A pure function of `parameters`, differentiable forward and in reverse by the implicit function
    theorem: one solve with the matrix of the last Newton iteration. The exact discrete identities
    $\partial E/\partial V_0 = P$, $\partial E/\partial A_0 = -\sigma$ and
    $\partial E/\partial H_0 = -\int y\cdot\nu$ hold to the tolerance.

    **Arguments:**

    - `parameters`: near those of `equilibrium.parameters`; entries that are not in force (tension
      where the area is held, say) are ignored.

    *Limits:* the discrete energy depends on the reference surface at the level of the
    discretisation error: take differences on one reference only.

    ```python
    def tension(v):
        p = eqx.tree_at(lambda p: p.volume, shape.parameters, v)
        return jw.equilibria.resolve(shape, p).tension

    slope = jax.grad(tension)(shape.parameters.volume)
    ```
    """
    r, units = equilibrium.reference, equilibrium.units
    flags = jnp.asarray(equilibrium.fixed_area), jnp.asarray(equilibrium.fixed_volume)
    return _resolved(r, units, flags, equilibrium.unknowns, parameters, tolerance, linear_solver)


@eqx.filter_jit
def _resolved(r, units, flags, start, parameters, tolerance, linear_solver) -> Resolved:
    scaled = units.parameters(parameters)
    area, volume = flags
    system = EquilibriumSystem(r, scaled, constant_path(r), area, volume, jnp.zeros(()))
    start = start.at[-1].set(0.0)
    solved = newton(system, start, tolerance, 20, linear_solver)
    x, Y, energy, tension, pressure, area, volume = dimensional(system, solved.unknowns, units)
    converged = solved.result == optx.RESULTS.successful
    return Resolved(x, Y, energy, tension, pressure, area, volume, converged)


def dimensional(system: EquilibriumSystem, unknowns, units: Units):
    """Nodes, Y, energy, tension, pressure, area and volume in the units of the user."""
    r, L, kappa = system.reference, units.length, units.kappa
    s, y, g = system.unpack(unknowns)
    x = r.positions(s)
    area, volume = area_and_volume(r.mesh, r.rule, x)
    return (
        units.outward(x),
        y * kappa / L,
        kappa * system.bending_energy(unknowns),
        g[0] * kappa / L**2,
        g[1] * kappa / L**3,
        area * L**2,
        volume * L**3,
    )


_dimensional = eqx.filter_jit(dimensional)


def finished(
    system: EquilibriumSystem,
    solved: Solved,
    result: RESULTS,
    units: Units,
    stability: bool,
    linear_solver: str,
    stats: dict[str, Any],
) -> Equilibrium:
    """Translate a dimensionless solution and look at its stability."""
    r = system.reference
    x, Y, energy, tension, pressure, area, volume = _dimensional(system, solved.unknowns, units)
    p = system.at(solved.unknowns[-1])
    parameters = Parameters(
        p.bending_modulus * units.kappa / 2,
        p.spontaneous_curvature / units.length,
        area,
        volume,
        tension,
        pressure,
    )
    values: tuple[float, ...] = ()
    if stability and bool(result == RESULTS.converged):
        found, _ = lowest_modes(system, solved.unknowns, N_MODES, linear_solver)
        values = tuple(float(value) for value in found)
    return Equilibrium(
        mesh=r.mesh,
        x=x,
        Y=Y,
        energy=energy,
        tension=tension,
        pressure=pressure,
        parameters=parameters,
        residual=float(solved.residual),
        negative_directions=sum(value < 0 for value in values) if values else None,
        eigenvalues=values,
        result=result,
        reference=r,
        units=units,
        unknowns=solved.unknowns,
        fixed_area=bool(system.fixed_area),
        fixed_volume=bool(system.fixed_volume),
        stats=stats,
    )

"""Equilibrium: what was found, and the differentiable function that finds it again."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ..surface import mean_curvature_vector
from ._density import CURVATURE, PATH, POTENTIAL, PRESSURE, TENSION, amount_of, area_and_volume
from ._diagnostics import MeshHealth, mesh_health
from ._functional import N_GLOBALS, EquilibriumSystem, Path, Reference, concentration
from ._parameters import Parameters, Scaled, Units
from ._phases import ScaledPhases
from ._results import RESULTS
from ._solve import Solved, newton
from ._stability import lowest_eigenvalues

N_MODES = 8


class Equilibrium(eqx.Module):
    r"""A stationary shape of the bending energy and global energies under constraints.

    **Attributes:**

    - `mesh`, `x`: the shape.
    - `Y`: nodal field $2 b_b (H - \hat H_0)\nu$, the moment that is in equilibrium;
      $\hat H_0 = H_0 - m/(2 b_b)$.
    - `c`: the concentration of a membrane of two phases, or `None`.
    - `energy`: $\int b_b (H - H_0)^2$, by the mixed functional.
    - `global_energy`: value of the global energies.
    - `mixing_energy`, `gaussian_energy`: $\int\Psi + \tfrac\gamma2|\nabla c|^2$ and
      $\int b_k(c) K$ of two phases; zero for one.
    - `tension`, `pressure`: $\sigma$ and $P = P_{in} - P_{out}$: multipliers, or the slopes
      $\partial_A f$ and $-\partial_V f$ of the global energies plus what is applied.
    - `curvature_multiplier`: $m = \partial_M f$; zero unless an energy depends on $M$.
    - `chemical_potential`: $\mu = \partial E/\partial\int c$ of two phases, or `None`.
    - `total_mean_curvature`: $M = \int H$.
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
    c: Float[Array, " nodes"] | None
    energy: Float[Array, ""]
    global_energy: Float[Array, ""]
    mixing_energy: Float[Array, ""]
    gaussian_energy: Float[Array, ""]
    tension: Float[Array, ""]
    pressure: Float[Array, ""]
    curvature_multiplier: Float[Array, ""]
    chemical_potential: Float[Array, ""] | None
    total_mean_curvature: Float[Array, ""]
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
    def total_energy(self) -> Float[Array, ""]:
        """All energies together."""
        return _total(self)

    @property
    def nodal_unknowns(self) -> tuple[Float[Array, "nodes fields"], Float[Array, " globals"]]:
        """Without dimension: `Y` with `c` beside it if there is one, and the global unknowns."""
        y = self.Y * self.units.length / self.units.kappa
        m = N_GLOBALS if self.c is None else N_GLOBALS + 1
        fields = y if self.c is None else jnp.concatenate([y, self.c[:, None]], axis=1)
        return fields, self.unknowns[-m:]

    @property
    def mean_concentration(self) -> Float[Array, ""] | None:
        r"""$\int c$ over the area, or `None`."""
        p = self.parameters
        return None if p.amount is None else p.amount / p.area

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
        r"""$E/(8\pi\kappa)$ with $\kappa = 2 b_b$: 1 for a sphere at $H_0 = 0$.

        Of two phases, E is the energy of bending alone and $\kappa$ the mean of both; likewise for
        the scaled multipliers below.
        """
        return self.energy / (16 * jnp.pi * self.parameters.bending_modulus)

    @property
    def effective_spontaneous_curvature(self) -> Float[Array, ""]:
        r"""$\hat H_0 = H_0 - m/(2 b_b)$: with area and volume held, this alone gives the shape."""
        p = self.parameters
        return p.spontaneous_curvature - self.curvature_multiplier / (2 * p.bending_modulus)

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
    def energy_error(self) -> float:
        r"""Estimated relative error of $\tfrac12\int H^2$ that is the mesh's.

        The weak mean curvature vector Y of a smooth surface is normal; its tangential part is an
        error, and at a stationary shape that of the energy is of its square:

        $$ \eta = 0.55 \int |Y - (Y\cdot n)\, n|^2 \Big/ \int |Y|^2. $$

        Against axisymmetric references, prolates, oblates and stomatocytes on graded meshes of
        degrees 2 to 4, it was within a factor of 3, and of 4 on 162 nodes.
        """
        return float(tangential_part(self.mesh, self.x))

    @property
    def succeeded(self) -> bool:
        """Whether the shape is stationary to the tolerance."""
        return bool(self.result == RESULTS.converged)


# Error of the energy over the tangential part of Y: 0.14 to 0.77 on smooth shapes, 1.2 to 1.6 on
# stomatocytes of v = 0.58.
OF_THE_TANGENTIAL_PART = 0.55


@eqx.filter_jit
def tangential_part(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
    """The estimate of `Equilibrium.energy_error`."""
    Y = mean_curvature_vector(mesh, x)

    def squares(point, f):
        whole = jnp.sum(f.Y.value**2)
        return jnp.stack([whole - jnp.sum(f.Y.value * point.normal) ** 2, whole])

    tangential, whole = integrate(mesh, x, squares, {"Y": Y})
    return OF_THE_TANGENTIAL_PART * tangential / whole


def constant_path(r: Reference, parameters: Parameters) -> Path:
    """No path: the extra unknown is zero."""
    zero = jnp.zeros(())
    return Path(no_direction(parameters), jnp.zeros(r.X.shape[0]), jnp.ones(()), zero)


def no_direction(parameters: Parameters) -> Parameters:
    """Zeros in the shape of parameters; functions among them stay what they are."""
    return jax.tree.map(lambda a: jnp.zeros_like(a) if eqx.is_array(a) else a, parameters)


def _total(shape):
    return shape.energy + shape.global_energy + shape.mixing_energy + shape.gaussian_energy


class Resolved(eqx.Module):
    """An equilibrium on a frozen reference, as a differentiable function of its parameters.

    Its fields are those of `Equilibrium`; `unknowns` in place of those of an equilibrium are the
    start for parameters farther away.
    """

    x: Float[Array, "nodes 3"]
    Y: Float[Array, "nodes 3"]
    c: Float[Array, " nodes"] | None
    energy: Float[Array, ""]
    global_energy: Float[Array, ""]
    mixing_energy: Float[Array, ""]
    gaussian_energy: Float[Array, ""]
    tension: Float[Array, ""]
    pressure: Float[Array, ""]
    curvature_multiplier: Float[Array, ""]
    chemical_potential: Float[Array, ""] | None
    total_mean_curvature: Float[Array, ""]
    area: Float[Array, ""]
    volume: Float[Array, ""]
    amount: Float[Array, ""] | None
    unknowns: Float[Array, " unknowns"]
    converged: Bool[Array, ""]

    @property
    def total_energy(self) -> Float[Array, ""]:
        """All energies together."""
        return _total(self)


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
    $\partial E/\partial H_0 = -\int y\cdot\nu + m A$ hold to the tolerance for the sum E of all
    energies, where those of area and volume do not enter what is held; with two phases also
    $\partial E/\partial\int c = \mu$, and by a parameter of the two-phase energy the derivative of
    that energy at the shape and the concentration as they are.

    **Arguments:**

    - `parameters`: near those of `equilibrium.parameters`, the constants of the global energies
      included; entries that are not in force (tension where the area is held, say) are ignored.
    - `linear_solver`: as in `equilibrium`; with `"dense"` many parameter sets are solved at once
      under `vmap`.

    *Limits:* the discrete energy depends on the reference surface at the level of the
    discretisation error: take differences on one reference only.

    ```python
    def tension(v):
        p = eqx.tree_at(lambda p: p.volume, shape.parameters, v)
        return jw.equilibria.resolve(shape, p).tension

    slope = jax.grad(tension)(shape.parameters.volume)
    line = lambda p: p.two_phase.mixing.well.line_tension  # as above, of two phases
    ```
    """
    r, units = equilibrium.reference, equilibrium.units
    flags = jnp.asarray(equilibrium.fixed_area), jnp.asarray(equilibrium.fixed_volume)
    if (parameters.two_phase is None) != (equilibrium.c is None):
        raise ValueError("`parameters` must have a `two_phase` energy just as the equilibrium has.")
    return _resolved(r, units, flags, equilibrium.unknowns, parameters, tolerance, linear_solver)


@eqx.filter_jit
def _resolved(r, units, flags, start, parameters, tolerance, linear_solver) -> Resolved:
    scaled = units.parameters(parameters)
    area, volume = flags
    path = constant_path(r, scaled)
    system = EquilibriumSystem(r, scaled, path, area, volume, jnp.zeros(()))
    start = start.at[PATH].set(0.0)
    solved = newton(system, start, tolerance, 20, linear_solver)
    converged = solved.result == optx.RESULTS.successful
    found = dimensional(system, solved.unknowns, units)
    return Resolved(**found, unknowns=solved.unknowns, converged=converged)


def dimensional(system: EquilibriumSystem, unknowns, units: Units) -> dict[str, Any]:
    """What `Resolved` holds, in the units of the user."""
    r, L, kappa = system.reference, units.length, units.kappa
    s, fields, g = system.unpack(unknowns)
    x, c = r.positions(s), concentration(fields)
    area, volume = area_and_volume(r.mesh, r.rule, x)
    energies = system.energies(unknowns)
    return {
        "x": units.outward(x),
        "Y": (fields if c is None else fields[:, :3]) * kappa / L,
        "c": c,
        "energy": kappa * energies.bending,
        "global_energy": kappa * energies.of_measures,
        "mixing_energy": kappa * energies.mixing,
        "gaussian_energy": kappa * energies.gaussian,
        "tension": g[TENSION] * kappa / L**2,
        "pressure": g[PRESSURE] * kappa / L**3,
        "curvature_multiplier": g[CURVATURE] * kappa / L,
        "chemical_potential": None if c is None else g[POTENTIAL] * kappa / L**2,
        "total_mean_curvature": energies.total_mean_curvature * L,
        "area": area * L**2,
        "volume": volume * L**3,
        "amount": None if c is None else amount_of(r.mesh, r.rule, x, c) * L**2,
    }


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
    found = _dimensional(system, solved.unknowns, units)
    p, L, kappa = system.at(solved.unknowns[PATH]), units.length, units.kappa
    fixed_area, fixed_volume = bool(system.fixed_area), bool(system.fixed_volume)
    parameters = Parameters(
        p.bending_modulus * kappa / 2,
        p.spontaneous_curvature / L,
        found.pop("area"),
        found.pop("volume"),
        found["tension"] if fixed_area else p.tension * kappa / L**2,
        found["pressure"] if fixed_volume else p.pressure * kappa / L**3,
        p.global_energy.energy if isinstance(p.global_energy, Scaled) else None,
        p.two_phase.energy if isinstance(p.two_phase, ScaledPhases) else None,
        found.pop("amount"),
    )
    values: tuple[float, ...] = ()
    if stability and bool(result == RESULTS.converged):
        values = lowest_eigenvalues(system, solved.unknowns, N_MODES, linear_solver)
    return Equilibrium(
        **found,
        mesh=r.mesh,
        parameters=parameters,
        residual=float(solved.residual),
        negative_directions=sum(value < 0 for value in values) if values else None,
        eigenvalues=values,
        result=result,
        reference=r,
        units=units,
        unknowns=solved.unknowns,
        fixed_area=fixed_area,
        fixed_volume=fixed_volume,
        stats=stats,
    )

r"""The constrained bending energy as a sparse saddle-point system on a frozen reference surface.

Everything in this module is dimensionless: lengths in units of the size of the surface, energies
in units of $\kappa = 2 b_b$. `Units` translates. A membrane of two phases has one nodal unknown
more, its concentration $c$, and one global one, the chemical potential $\mu$ of the amount
$\int c$ that is held.

Besides the bending energy there may be an energy $f(A, V_p, M)$ of area, volume and $M = \int H$.
Its slopes $\sigma = \partial_A f$, $P = -\partial_V f$, $m = \partial_M f$ are unknowns. The term
$m M$ completes the square of the bending energy,

$$ \frac\kappa2\int (H - H_0)^2 + m\int H = \frac\kappa2\int (H - \hat H_0)^2
    + \frac\kappa2 (H_0^2 - \hat H_0^2) A, \qquad \hat H_0 = H_0 - m/\kappa, $$

so that it acts as a shift of the spontaneous curvature and of the tension.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..fem import gather, planned_cell_jacobians
from ..linalg import (
    AbstractSparseSystem,
    Border,
    SparseOperator,
    scatter_blocks,
)
from ._density import (
    CURVATURE,
    ONE_PHASE,
    PATH,
    POTENTIAL,
    PRESSURE,
    RIGID,
    TENSION,
    TWO_PHASES,
    area_and_volume,
    integral,
    mixing,
)
from ._frozen import Path as Path, Reference as Reference
from ._parameters import Parameters, Scaled, phases_of
from ._phases import gaussian_second_derivatives

# Softness of the six rigid constraints: a shape that feels a discrete torque may turn a little.
RIGID_SOFTNESS = 1e-3
# A change of the concentration counts as this many times as long a displacement.
OF_CHANGE = 0.25
# Global unknowns of a membrane of one phase.
N_GLOBALS = 10


class Energies(NamedTuple):
    """The parts of the energy, dimensionless, and the total mean curvature."""

    bending: Float[Array, ""]
    of_measures: Float[Array, ""]
    total_mean_curvature: Float[Array, ""]
    mixing: Float[Array, ""]
    gaussian: Float[Array, ""]

    @property
    def total(self) -> Float[Array, ""]:
        """The sum of the energies."""
        return self.bending + self.of_measures + self.mixing + self.gaussian


class Assessment(NamedTuple):
    """What decides whether a step is taken, dimensionless."""

    step: Float[Array, ""]
    """The largest displacement, or change of the concentration if that is more."""
    displacement: Float[Array, ""]
    objective: Float[Array, ""]
    """What a step lowers: energies and the work of an applied tension and pressure."""
    bending: Float[Array, ""]
    nodes: Float[Array, "nodes 3"]


def concentration(fields) -> Float[Array, " nodes"] | None:
    """The concentration among the nodal unknowns `(y, c)`, if it is there."""
    return fields[:, 3] if fields.shape[1] > 3 else None


def _scaled(p: Parameters) -> Scaled:
    """The global energy of dimensionless parameters that have one."""
    assert isinstance(p.global_energy, Scaled)
    return p.global_energy


class EquilibriumSystem(AbstractSparseSystem):
    r"""Stationarity of the constrained functional on a frozen reference surface.

    $$ L = F(X + s n, y, c;\, \sigma, P, m, \mu) + \mu_r\cdot R\,(s, \delta c)
        - \tfrac{\epsilon}{2}|\mu_r|^2 + \frac{1}{2\tau} (s^T M s + \delta c^T M \delta c) $$

    with F the integral of `density`, $\int b_k(c)\,\mathrm dK$ added to it, and $\delta c$ the
    change of the concentration since the reference.

    Nodal unknowns are $(s, y)$, or $(s, y, c)$; the global ones $\sigma$, $P$, $m$, six rigid
    multipliers $\mu_r$, with a concentration its chemical potential $\mu$, and the path parameter
    $p$. $\sigma$ and $P$ are multipliers where area and volume are held, else slopes of the global
    energy plus what is applied. The derivatives of F by $\sigma$, $-P$, $m$ and $-\mu$ are area,
    volume, $M$ and amount.

    **Attributes:**

    - `parameters`: dimensionless.
    - `fixed_area`, `fixed_volume`: hold area (volume), or let the energies decide.
    - `inverse_tau`: $1/\tau$ of pseudo-time; zero for the equilibrium itself.
    """

    reference: Reference
    parameters: Parameters
    path: Path
    fixed_area: Bool[Array, ""]
    fixed_volume: Bool[Array, ""]
    inverse_tau: Float[Array, ""]

    @property
    def pattern(self):
        return self.reference.pattern

    @property
    def has_phases(self) -> bool:
        """Whether there is a concentration."""
        return self.reference.c is not None

    @property
    def n_fields(self) -> int:
        """Unknowns of a node."""
        return 4 + self.has_phases

    @property
    def n_globals(self):
        return N_GLOBALS + self.has_phases

    def pack(self, s, fields, unknowns) -> Float[Array, " unknowns"]:
        """The flat vector of displacements, the other nodal unknowns, and the global ones."""
        nodal = jnp.concatenate([s[:, None], fields], axis=1)
        return jnp.concatenate([nodal.reshape(-1), unknowns])

    def unpack(self, v: Float[Array, " unknowns"]):
        """Displacements, `y` (with `c` as a last column), globals; the inverse of `pack`."""
        U = v[: -self.n_globals].reshape(-1, self.n_fields)
        return U[:, 0], U[:, 1:], v[-self.n_globals :]

    def at(self, p: Float[Array, ""]) -> Parameters:
        """Parameters at a point of the path."""

        def moved(a, d):
            return a + p * d if eqx.is_array(a) else a

        return jax.tree.map(moved, self.parameters, self.path.direction)

    def _changed(self, U):
        """s, and the change of c beside it if there is one: what gauge and pseudo-time see."""
        r = self.reference
        return U[:, :1] if r.c is None else jnp.stack([U[:, 0], U[:, 4] - r.c], axis=1)

    def stationarity(self, U, g):
        r"""Derivatives of L by the nodal unknowns, and of F by $\sigma$, $-P$, $m$, $-\mu$."""
        r, p = self.reference, self.at(g[PATH])

        def functional(U, g):
            x = r.positions(U[:, 0])
            F = integral(r.mesh, r.rule, jnp.concatenate([x, U[:, 1:]], axis=1), p, g)
            if self.has_phases and phases_of(p).is_gaussian:
                F = F + phases_of(p).gaussian(r.mesh, x, U[:, 4])
            return F

        slope, by_g = jax.grad(functional, argnums=(0, 1))(U, g)
        measures = [by_g[TENSION], -by_g[PRESSURE], by_g[CURVATURE]]
        measures += [-by_g[POTENTIAL]] if self.has_phases else []
        gauge = jnp.tensordot(g[RIGID], r.rigid_rows, axes=1)
        pull = self.inverse_tau * jax.vmap(r.times_mass, 1, 1)(self._changed(U))
        slope = (slope + gauge).at[:, 0].add(pull[:, 0])
        slope = slope.at[:, 4].add(pull[:, 1]) if self.has_phases else slope
        return slope, jnp.stack(measures)

    def _closures(self, measures, g):
        """Equations of tension, pressure, curvature multiplier and amount, of order one."""
        p = self.at(g[PATH])
        area, volume, M = measures[:3]
        f_A, f_V, f_M = 3 * (jnp.zeros(()),)
        if p.global_energy is not None:
            f_A, f_V, f_M = jax.grad(_scaled(p).of, argnums=(0, 1, 2))(area, volume, M)
        of_tension = jnp.where(
            self.fixed_area, (area - p.area) / (4 * jnp.pi), g[TENSION] - p.tension - f_A
        )
        of_pressure = jnp.where(
            self.fixed_volume,
            (volume - p.volume) / (4 * jnp.pi / 3),
            g[PRESSURE] - p.pressure + f_V,
        )
        closures = [of_tension, of_pressure, g[CURVATURE] - f_M]
        closures += [] if p.amount is None else [(measures[3] - p.amount) / (4 * jnp.pi)]
        return jnp.stack(closures)

    def residual(self, y):
        s, fields, g = self.unpack(y)
        r, U = self.reference, jnp.concatenate([s[:, None], fields], axis=1)
        slope, measures = self.stationarity(U, g)
        closures = self._closures(measures, g)
        of_rigid = r.rigid @ s - RIGID_SOFTNESS * g[RIGID]
        if r.rigid_c is not None:
            of_rigid = of_rigid + r.rigid_c @ self._changed(U)[:, 1]
        of_path = jnp.sum(self.path.shape * s) + self.path.weight * g[PATH] - self.path.length
        tail = [closures[:3], of_rigid, closures[3:], of_path[None]]
        return jnp.concatenate([slope.reshape(-1), *tail])

    @eqx.filter_jit
    def energies(self, v: Float[Array, " unknowns"]) -> Energies:
        """The parts of the energy, and the total mean curvature."""
        s, fields, g = self.unpack(v)
        r, p, zero = self.reference, self.at(g[PATH]), jnp.zeros(())
        x, U = r.positions(s), jnp.concatenate([s[:, None], fields], axis=1)
        A, V, M = self.stationarity(U, g)[1][:3]
        # Without loads; what m adds is taken off again.
        bare = jnp.zeros_like(g).at[CURVATURE].set(g[CURVATURE])
        F = integral(r.mesh, r.rule, jnp.concatenate([x, fields], axis=1), p, bare)
        of = zero if p.global_energy is None else _scaled(p).of(A, V, M)
        mixed, gaussian = zero, zero
        if r.c is not None:
            c = fields[:, 3]
            mixed, gaussian = mixing(r.mesh, r.rule, x, c, p), phases_of(p).gaussian(r.mesh, x, c)
        return Energies(F - mixed - g[CURVATURE] * M, of, M, mixed, gaussian)

    @eqx.filter_jit
    def assessed(self, v: Float[Array, " unknowns"]) -> Assessment:
        """Steps and energies of a solution, in one compiled function."""
        s, fields, g = self.unpack(v)
        r, p = self.reference, self.at(g[PATH])
        x, energies = r.positions(s), self.energies(v)
        area, volume = area_and_volume(r.mesh, r.rule, x)
        work = jnp.where(self.fixed_area, 0.0, p.tension * area)
        work = work - jnp.where(self.fixed_volume, 0.0, p.pressure * volume)
        step = displacement = jnp.max(jnp.abs(s))
        if r.c is not None:
            step = jnp.maximum(step, OF_CHANGE * jnp.max(jnp.abs(fields[:, 3] - r.c)))
        return Assessment(step, displacement, energies.total + work, energies.bending, x)

    def blocks(self, y) -> Float[Array, "blocks fields fields"]:
        """Second derivative of L by the nodal unknowns."""
        s, fields, g = self.unpack(y)
        r, p = self.reference, self.at(g[PATH])
        x, form = r.positions(s), TWO_PHASES if self.has_phases else ONE_PHASE
        U = jnp.concatenate([x, fields], axis=1)
        by_all = planned_cell_jacobians(form, r.mesh, r.rule, x, U, x[:, :0], (p, g))
        # Nodes move along their normals only.
        along = jnp.zeros((len(s), form.trial.width, self.n_fields)).at[:, :3, 0].set(r.n)
        along = gather(r.mesh, along.at[:, 3:, 1:].set(jnp.eye(self.n_fields - 1)[None]))
        local = jnp.einsum("tmfa,tmnfg,tngb->tmnab", along, by_all, along)
        c_c = jnp.zeros(len(s))
        if self.has_phases and phases_of(p).is_gaussian:
            gaussian = gaussian_second_derivatives(phases_of(p), r.mesh, x, r.n, fields[:, 3])
            local = local.at[..., 0, 0].add(gaussian[0]).at[..., 4, 0].add(gaussian[1])
            local = local.at[..., 0, 4].add(gaussian[1].swapaxes(1, 2))
            c_c = gaussian[2]
        blocks = scatter_blocks(r.pattern, local)
        blocks = blocks.at[:, 0, 0].add(self.inverse_tau * r.mass)
        if not self.has_phases:
            return blocks
        diagonal = jnp.where(r.pattern.rows == r.pattern.cols, c_c[r.pattern.rows], 0.0)
        return blocks.at[:, 4, 4].add(self.inverse_tau * r.mass + diagonal)

    def jacobian(self, y):
        s, fields, g = self.unpack(y)
        U = jnp.concatenate([s[:, None], fields], axis=1)
        # The rigid multipliers are the only global unknowns that the integrand does not see.
        closed = [TENSION, PRESSURE, CURVATURE, *([POTENTIAL] if self.has_phases else [])]
        varied = jnp.array([*closed, PATH])

        def by(direction):
            return jax.jvp(lambda g: self.stationarity(U, g), (g,), (direction,))[1]

        of_varied, of_measures = jax.vmap(by)(jnp.eye(len(g))[varied])
        columns = jnp.zeros((len(g), *U.shape)).at[varied].set(of_varied)
        columns = columns.at[RIGID].set(self.reference.rigid_rows)
        # What the closures see of the nodes are measures, the derivatives of F by the multipliers.
        signs = jnp.array([1.0, -1.0, 1.0, -1.0])[: len(closed)]
        measures = self.stationarity(U, g)[1]
        by_measures, by_g = jax.jacfwd(self._closures, argnums=(0, 1))(measures, g)
        by_g = by_g.at[:, varied].add(by_measures @ of_measures.T)
        closed = jnp.array(closed)
        rows = jnp.zeros_like(columns)
        rows = rows.at[closed].set(
            jnp.tensordot(by_measures * signs[None], columns[closed], axes=1)
        )
        rows = rows.at[RIGID].set(self.reference.rigid_rows)
        rows = rows.at[PATH, :, 0].set(self.path.shape)
        corner = jnp.zeros((len(g), len(g))).at[closed].set(by_g)
        corner = corner.at[RIGID, RIGID].set(-RIGID_SOFTNESS * jnp.eye(6))
        corner = corner.at[PATH, PATH].set(self.path.weight)
        return SparseOperator(self.blocks(y), self.pattern, Border(columns, rows, corner))

r"""The constrained bending energy as a sparse saddle-point system on a frozen reference surface.

Everything in this module is dimensionless: lengths in units of the size of the surface, energies
in units of $\kappa = 2 b_b$. `Units` translates.

Besides the bending energy there may be an energy $f(A, V_p, M)$ of area, volume and $M = \int H$.
Its slopes $\sigma = \partial_A f$, $P = -\partial_V f$, $m = \partial_M f$ are unknowns. The term
$m M$ completes the square of the bending energy,

$$ \frac\kappa2\int (H - H_0)^2 + m\int H = \frac\kappa2\int (H - \hat H_0)^2
    + \frac\kappa2 (H_0^2 - \hat H_0^2) A, \qquad \hat H_0 = H_0 - m/\kappa, $$

so that it acts as a shift of the spontaneous curvature and of the tension.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..fem import Rule, gather, point, trace
from ..linalg import (
    AbstractSparseSystem,
    BlockPattern,
    Border,
    SparseOperator,
    scatter_blocks,
)
from ..mesh import SurfaceMesh
from ._parameters import Parameters, Scaled

# Cells differentiated together; small batches stay in cache (measured in `fem`).
CELL_BATCH = 16
# Softness of the six rigid constraints: a shape that feels a discrete torque may turn a little.
RIGID_SOFTNESS = 1e-3
# Order of the global unknowns: tension, pressure, curvature multiplier, six rigid ones, path.
TENSION, PRESSURE, CURVATURE, RIGID, PATH, N_GLOBALS = 0, 1, 2, slice(3, 9), 9, 10


class Reference(eqx.Module):
    """The frozen surface that unknown normal displacements refer to.

    **Attributes:**

    - `mesh`, `rule`, `pattern`: connectivity, quadrature and sparsity.
    - `X`, `n`: nodes and unit normals; the unknown surface has nodes `X + s n`.
    - `mass`, `stiffness`: entries of the matrices of `X` on the pattern.
    - `rigid`: six rows; their product with `s` is the rigid motion in it.
    """

    mesh: SurfaceMesh
    rule: Rule
    pattern: BlockPattern
    X: Float[Array, "nodes 3"]
    n: Float[Array, "nodes 3"]
    mass: Float[Array, " blocks"]
    stiffness: Float[Array, " blocks"]
    rigid: Float[Array, "6 nodes"]

    def positions(self, s: Float[Array, " nodes"]) -> Float[Array, "nodes 3"]:
        """Nodes displaced by `s` along the normals."""
        return self.X + s[:, None] * self.n

    def times_mass(self, u: Float[Array, " nodes"]) -> Float[Array, " nodes"]:
        """Product with the mass matrix."""
        return jnp.zeros_like(u).at[self.pattern.rows].add(self.mass * u[self.pattern.cols])


class Path(eqx.Module):
    r"""A line in parameter space and the equation that picks a point on it.

    Parameters are `start + p direction` with $p$ an unknown. Its equation is
    `shape · s + weight p = length`; with `shape = 0`, `weight = 1` it prescribes $p$.
    """

    direction: Parameters
    shape: Float[Array, " nodes"]
    weight: Float[Array, ""]
    length: Float[Array, ""]


def density(P, H0, kappa, tension, pressure) -> Float[Array, ""]:
    r"""The mixed functional at one quadrature point, times the area element.

    $$ \nabla_\Gamma\cdot y - H_0\, y\cdot\nu - \frac{|y|^2}{2\kappa}
        + \sigma - \tfrac13 P\, x\cdot\nu $$

    Integrated and maximised over $y$ it becomes $\frac\kappa2\int (H - H_0)^2 + \sigma|\Gamma|
    - P V_p$, with $y = \kappa (H - H_0)\nu$, since $\int \nabla_\Gamma\cdot y = \int H y\cdot\nu$
    on a closed surface. No second derivative appears.

    **Arguments:**

    - `P`: value and two reference derivatives of the six components of $x$ and $y$.
    """
    here = point(P[:3, 0], P[:3, 1:])
    y, grad_y = P[3:, 0], P[3:, 1:] @ here.lift.T
    bending = trace(grad_y) - H0 * jnp.sum(y * here.normal) - jnp.sum(y * y) / (2 * kappa)
    work = tension - pressure * jnp.sum(here.position * here.normal) / 3
    return here.dA * (bending + work)


def second_derivatives(P: Float[Array, "6 3"], H0, kappa, tension, pressure):
    r"""Second derivatives of `density` at one quadrature point.

    Only the two tangents are differentiated twice: `density` is linear in the position and, but
    for $-|y|^2/2\kappa$, in the jet of $y$.

    **Returns:** the derivative of the gradient by the jet of $x$, of shape `(6, 3, 3, 3)`, and the
    one number on the diagonal of the derivative by the value of $y$ twice.
    """

    def gradient(J):
        jets = jnp.concatenate([jnp.concatenate([P[:3, :1], J], axis=1), P[3:]])
        return jax.grad(density)(jets, H0, kappa, tension, pressure)

    J = P[:3, 1:]
    by_J = jax.jacfwd(gradient)(J)
    of_position = jnp.moveaxis(by_J[:3, 0], 0, -1)  # by a tangent and the position
    by_position = jnp.concatenate([jnp.zeros((3, 1, 3)), of_position], axis=1)
    by_position = jnp.concatenate([by_position, jnp.zeros((3, 3, 3))])
    by_x = jnp.concatenate([by_position[..., None], by_J], axis=3)
    return by_x, -jnp.linalg.norm(jnp.cross(J[:, 0], J[:, 1])) / kappa


def integral(mesh: SurfaceMesh, rule: Rule, x, y, coefficients) -> Float[Array, ""]:
    """Integral of `density`; `coefficients` are its last four arguments."""

    def cell(local):
        def at(phi, weight):
            return weight * density(local.T @ phi, *coefficients)

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights))

    return jnp.sum(jax.vmap(cell)(gather(mesh, jnp.concatenate([x, y], axis=1))))


@eqx.filter_jit
def area_and_volume(mesh: SurfaceMesh, rule: Rule, x: Float[Array, "nodes 3"]):
    """Area and enclosed volume by the quadrature of the functional."""

    def cell(x_T):
        def at(phi, weight):
            X = x_T.T @ phi
            cross = jnp.cross(X[:, 1], X[:, 2])
            return weight * jnp.stack([jnp.linalg.norm(cross), jnp.sum(X[:, 0] * cross) / 3])

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights), axis=0)

    both = jnp.sum(jax.vmap(cell)(gather(mesh, x)), axis=0)
    return both[0], both[1]


def _scaled(p: Parameters) -> Scaled:
    """The global energy of dimensionless parameters that have one."""
    assert isinstance(p.global_energy, Scaled)
    return p.global_energy


class EquilibriumSystem(AbstractSparseSystem):
    r"""Stationarity of the constrained functional on a frozen reference surface.

    $$ L = F(X + s n, y;\, \hat H_0) + \hat\sigma |\Gamma| - P V_p + \mu\cdot R s
        - \tfrac{\epsilon}{2}|\mu|^2 + \frac{1}{2\tau} s^T M s, \qquad
       \hat\sigma = \sigma + \tfrac\kappa2 (H_0^2 - \hat H_0^2) $$

    Nodal unknowns are $(s, y)$; the global ones $\sigma$, $P$, $m$, six rigid multipliers $\mu$
    and the path parameter $p$. $\sigma$ and $P$ are multipliers where area and volume are held,
    else slopes of the global energy plus what is applied. Since $\partial L/\partial m = M$ is
    $\int y\cdot\nu/\kappa + \hat H_0 |\Gamma|$, that is the $M$ the energy is evaluated at.

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
    def n_globals(self):
        return N_GLOBALS

    def pack(self, s, y, unknowns) -> Float[Array, " unknowns"]:
        """The flat vector of displacements, `y` and global unknowns."""
        return jnp.concatenate([jnp.concatenate([s[:, None], y], axis=1).reshape(-1), unknowns])

    def unpack(self, v: Float[Array, " unknowns"]):
        """Displacements, `y` and global unknowns; the inverse of `pack`."""
        U = v[:-N_GLOBALS].reshape(-1, 4)
        return U[:, 0], U[:, 1:], v[-N_GLOBALS:]

    def at(self, p: Float[Array, ""]) -> Parameters:
        """Parameters at a point of the path."""
        return jax.tree.map(lambda a, d: a + p * d, self.parameters, self.path.direction)

    def coefficients(self, g):
        r"""$\hat H_0$, $\kappa$, $\hat\sigma$ and $P$: what the integrand needs."""
        p = self.at(g[PATH])
        H0, kappa = p.spontaneous_curvature, p.bending_modulus
        shifted = H0 - g[CURVATURE] / kappa
        tension = g[TENSION] + kappa / 2 * (H0**2 - shifted**2)
        return shifted, kappa, tension, g[PRESSURE]

    def _measures(self, U):
        r"""Area, enclosed volume and $\int y\cdot\nu$."""
        r = self.reference
        x = r.positions(U[:, 0])

        def cell(local):
            def at(phi, weight):
                P = local.T @ phi
                cross = jnp.cross(P[:3, 1], P[:3, 2])
                sums = jnp.sum(P[:3, 0] * cross) / 3, jnp.sum(P[3:, 0] * cross)
                return weight * jnp.stack([jnp.linalg.norm(cross), *sums])

            return jnp.sum(jax.vmap(at)(r.rule.phi, r.rule.weights), axis=0)

        cells = gather(r.mesh, jnp.concatenate([x, U[:, 1:]], axis=1))
        return jnp.sum(jax.vmap(cell)(cells), axis=0)

    def _arguments(self, measures, g):
        r"""Area, volume and $M$: the arguments of the global energy."""
        shifted, kappa, _, _ = self.coefficients(g)
        return measures[0], measures[1], measures[2] / kappa + shifted * measures[0]

    @eqx.filter_jit
    def energies(self, v: Float[Array, " unknowns"]):
        """Bending energy, global energy, and total mean curvature."""
        s, y, g = self.unpack(v)
        r, p, zero = self.reference, self.at(g[PATH]), jnp.zeros(())
        shifted, kappa, tension, _ = self.coefficients(g)
        measures = self._measures(jnp.concatenate([s[:, None], y], axis=1))
        A, V, M = self._arguments(measures, g)
        F = integral(r.mesh, r.rule, r.positions(s), y, (shifted, kappa, zero, zero))
        bending = F + (tension - g[TENSION]) * A - g[CURVATURE] * M
        of = zero if p.global_energy is None else _scaled(p).of(A, V, M)
        return bending, of, M

    @eqx.filter_jit
    def objective(self, v: Float[Array, " unknowns"]) -> Float[Array, ""]:
        """What a step lowers: energies and the work of an applied tension and pressure."""
        s, _, g = self.unpack(v)
        r, p = self.reference, self.at(g[PATH])
        area, volume = area_and_volume(r.mesh, r.rule, r.positions(s))
        bending, of, _ = self.energies(v)
        work = jnp.where(self.fixed_area, 0.0, p.tension * area)
        return bending + of + work - jnp.where(self.fixed_volume, 0.0, p.pressure * volume)

    def _nodal(self, U, g):
        """Derivative of L by the nodal unknowns."""
        r, coefficients = self.reference, self.coefficients(g)

        def functional(U):
            return integral(r.mesh, r.rule, r.positions(U[:, 0]), U[:, 1:], coefficients)

        slope = jax.grad(functional)(U)
        extra = g[RIGID] @ r.rigid + self.inverse_tau * r.times_mass(U[:, 0])
        return slope.at[:, 0].add(extra)

    def _slopes(self, measures, g):
        """Equations of tension, pressure and curvature multiplier, of order one."""
        p = self.at(g[PATH])
        area, volume, M = self._arguments(measures, g)
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
        return jnp.stack([of_tension, of_pressure, g[CURVATURE] - f_M])

    def residual(self, y):
        s, Y, g = self.unpack(y)
        r, U = self.reference, jnp.concatenate([s[:, None], Y], axis=1)
        of_rigid = r.rigid @ s - RIGID_SOFTNESS * g[RIGID]
        of_path = jnp.sum(self.path.shape * s) + self.path.weight * g[PATH] - self.path.length
        closures = [self._slopes(self._measures(U), g), of_rigid, of_path[None]]
        return jnp.concatenate([self._nodal(U, g).reshape(-1), *closures])

    def blocks(self, y) -> Float[Array, "blocks 4 4"]:
        """Second derivative of L by the nodal unknowns."""
        s, Y, g = self.unpack(y)
        r, coefficients = self.reference, self.coefficients(g)
        pairs = jnp.einsum("q,qmi,qnj->qijmn", r.rule.weights, r.rule.phi, r.rule.phi)

        def cell(inputs):
            fields, n_T = inputs
            P = jnp.einsum("mf,qmi->qfi", fields, r.rule.phi)
            by_x, by_y = jax.vmap(lambda P: second_derivatives(P, *coefficients))(P)
            both = jnp.einsum("qfigj,qijmn->mnfg", by_x, pairs)
            # Nodes move along their normals only.
            s_s = jnp.einsum("mf,mnfg,ng->mn", n_T, both[:, :, :3], n_T)
            y_s = jnp.einsum("mnfg,ng->mnf", both[:, :, 3:], n_T)
            y_y = jnp.einsum("q,qmn,fg->mnfg", by_y, pairs[:, 0, 0], jnp.eye(3))
            of_s = jnp.concatenate([s_s[..., None, None], y_s.swapaxes(0, 1)[..., None, :]], axis=3)
            of_y = jnp.concatenate([y_s[..., None], y_y], axis=3)
            return jnp.concatenate([of_s, of_y], axis=2)

        fields = jnp.concatenate([r.positions(s), Y], axis=1)
        cells = gather(r.mesh, fields), gather(r.mesh, r.n)
        local = jax.lax.map(cell, cells, batch_size=CELL_BATCH)
        blocks = scatter_blocks(r.pattern, local)
        return blocks.at[:, 0, 0].add(self.inverse_tau * r.mass)

    def jacobian(self, y):
        s, Y, g = self.unpack(y)
        U = jnp.concatenate([s[:, None], Y], axis=1)
        # The rigid multipliers are the only global unknowns that the integrand does not see.
        varied = jnp.array([TENSION, PRESSURE, CURVATURE, PATH])

        def by(direction):
            return jax.jvp(lambda g: self._nodal(U, g), (g,), (direction,))[1]

        columns = jnp.zeros((N_GLOBALS, *U.shape))
        columns = columns.at[varied].set(jax.vmap(by)(jnp.eye(N_GLOBALS)[varied]))
        columns = columns.at[RIGID, :, 0].set(self.reference.rigid)
        border = Border(columns, *self._closure_derivatives(U, g, columns))
        return SparseOperator(self.blocks(y), self.pattern, border)

    def _closure_derivatives(self, U, g, columns):
        """Derivatives of the global equations by the nodal and by the global unknowns."""
        by_measures, by_globals = jax.jacfwd(self._slopes, argnums=(0, 1))(self._measures(U), g)
        shifted, kappa, _, _ = self.coefficients(g)
        # L depends on σ, P and m through area, volume and M: its mixed derivatives are gradients.
        of_area, of_volume = columns[TENSION], -columns[PRESSURE]
        of_flux = kappa * (columns[CURVATURE] - shifted * of_area)
        gradients = jnp.stack([of_area, of_volume, of_flux])
        rows = jnp.zeros_like(columns)
        rows = rows.at[:3].set(jnp.einsum("km,mna->kna", by_measures, gradients))
        rows = rows.at[RIGID, :, 0].set(self.reference.rigid)
        rows = rows.at[PATH, :, 0].set(self.path.shape)
        soft = jnp.full(6, -RIGID_SOFTNESS)
        corner = jnp.diag(jnp.concatenate([jnp.zeros(3), soft, self.path.weight[None]]))
        return rows, corner.at[:3].set(by_globals)

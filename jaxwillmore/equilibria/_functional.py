r"""The constrained bending energy as a sparse saddle-point system on a frozen reference surface.

Everything in this module is dimensionless: lengths in units of the size of the surface, energies
in units of $\kappa = 2 b_b$. `Units` translates.
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

# Cells differentiated together; small batches stay in cache (measured in `fem`).
CELL_BATCH = 16
# Softness of the six rigid constraints: a shape that feels a discrete torque may turn a little.
RIGID_SOFTNESS = 1e-3
N_GLOBALS = 9


class Parameters(eqx.Module):
    r"""What an equilibrium depends on.

    **Attributes:**

    - `bending_modulus`: $b_b = \kappa/2$, energy.
    - `spontaneous_curvature`: $H_0$, 1/length.
    - `area`, `volume`: the values held, where they are held.
    - `tension`, `pressure`: $\sigma$ and $P = P_{in} - P_{out}$, where area or volume are free.
    """

    bending_modulus: Float[Array, ""]
    spontaneous_curvature: Float[Array, ""]
    area: Float[Array, ""]
    volume: Float[Array, ""]
    tension: Float[Array, ""]
    pressure: Float[Array, ""]


class Units(eqx.Module):
    r"""Length, $\kappa$ and origin that make a problem dimensionless; frozen numbers."""

    length: Float[Array, ""]
    kappa: Float[Array, ""]
    origin: Float[Array, "3"]

    def inward(self, x: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
        """Dimensionless nodes."""
        return (x - self.origin[None]) / self.length

    def outward(self, X: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
        """Nodes in the units of the user; the inverse of `inward`."""
        return self.origin[None] + self.length * X

    def parameters(self, p: Parameters) -> Parameters:
        """Dimensionless parameters; the modulus becomes $\\kappa$ in its unit."""
        L, kappa = self.length, self.kappa
        return Parameters(
            2 * p.bending_modulus / kappa,
            p.spontaneous_curvature * L,
            p.area / L**2,
            p.volume / L**3,
            p.tension * L**2 / kappa,
            p.pressure * L**3 / kappa,
        )


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


class EquilibriumSystem(AbstractSparseSystem):
    r"""Stationarity of the constrained functional on a frozen reference surface.

    $$ L = F(X + s n, y) + \sigma (|\Gamma| - A_0) - P (V_p - V_0) + \mu\cdot R s
        - \tfrac{\epsilon}{2}|\mu|^2 + \frac{1}{2\tau} s^T M s $$

    Nodal unknowns are $(s, y)$; the global ones $\sigma$, $P$, six rigid multipliers $\mu$ and the
    path parameter $p$. The matrix is symmetric up to the equations of a prescribed tension or
    pressure and of the path.

    **Attributes:**

    - `parameters`: dimensionless.
    - `fixed_area`, `fixed_volume`: hold area (volume), or prescribe tension (pressure).
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

    @eqx.filter_jit
    def bending_energy(self, v: Float[Array, " unknowns"]) -> Float[Array, ""]:
        """The functional F, the bending energy at an equilibrium."""
        s, y, g = self.unpack(v)
        p = self.at(g[8])
        zero = jnp.zeros(())
        r = self.reference
        coefficients = p.spontaneous_curvature, p.bending_modulus, zero, zero
        return integral(r.mesh, r.rule, r.positions(s), y, coefficients)

    def _nodal(self, U, g):
        """Derivative of L by the nodal unknowns."""
        r, p = self.reference, self.at(g[8])
        coefficients = p.spontaneous_curvature, p.bending_modulus, g[0], g[1]

        def functional(U):
            return integral(r.mesh, r.rule, r.positions(U[:, 0]), U[:, 1:], coefficients)

        slope = jax.grad(functional)(U)
        extra = g[2:8] @ r.rigid + self.inverse_tau * r.times_mass(U[:, 0])
        return slope.at[:, 0].add(extra)

    def _closures(self, U, g):
        """Equations of the global unknowns, of order one."""
        r, p, s = self.reference, self.at(g[8]), U[:, 0]
        area, volume = area_and_volume(r.mesh, r.rule, r.positions(s))
        of_tension = jnp.where(self.fixed_area, (area - p.area) / (4 * jnp.pi), g[0] - p.tension)
        of_pressure = jnp.where(
            self.fixed_volume, (volume - p.volume) / (4 * jnp.pi / 3), g[1] - p.pressure
        )
        of_rigid = r.rigid @ s - RIGID_SOFTNESS * g[2:8]
        of_path = jnp.sum(self.path.shape * s) + self.path.weight * g[8] - self.path.length
        return jnp.concatenate([jnp.stack([of_tension, of_pressure]), of_rigid, of_path[None]])

    def residual(self, y):
        s, Y, g = self.unpack(y)
        U = jnp.concatenate([s[:, None], Y], axis=1)
        return jnp.concatenate([self._nodal(U, g).reshape(-1), self._closures(U, g)])

    def blocks(self, y) -> Float[Array, "blocks 4 4"]:
        """Second derivative of L by the nodal unknowns."""
        s, Y, g = self.unpack(y)
        r, p = self.reference, self.at(g[8])
        coefficients = p.spontaneous_curvature, p.bending_modulus, g[0], g[1]

        def cell(inputs):
            fields, n_T = inputs

            def at(phi, weight):
                hessian = jax.hessian(density)(fields.T @ phi, *coefficients)
                return weight * jnp.einsum("mi,figj,nj->mnfg", phi, hessian, phi)

            full = jnp.sum(jax.vmap(at)(r.rule.phi, r.rule.weights), axis=0)
            # Nodes move along their normals only: contract the three columns of x with n.
            zero, eye = jnp.zeros((n_T.shape[0], 3, 3)), jnp.eye(3)
            to_x = jnp.concatenate([n_T[:, :, None], zero], axis=2)
            to_y = jnp.concatenate([zero[:, :, :1], zero + eye[None]], axis=2)
            N = jnp.concatenate([to_x, to_y], axis=1)
            return jnp.einsum("mfa,mnfg,ngb->mnab", N, full, N)

        fields = jnp.concatenate([r.positions(s), Y], axis=1)
        cells = gather(r.mesh, fields), gather(r.mesh, r.n)
        local = jax.lax.map(cell, cells, batch_size=CELL_BATCH)
        blocks = scatter_blocks(r.pattern, local)
        return blocks.at[:, 0, 0].add(self.inverse_tau * r.mass)

    def jacobian(self, y):
        s, Y, g = self.unpack(y)
        U = jnp.concatenate([s[:, None], Y], axis=1)
        # Only tension, pressure and p enter through the integrand.
        varied = jnp.array([0, 1, 8])

        def by(direction):
            return jax.jvp(lambda g: self._nodal(U, g), (g,), (direction,))[1]

        columns = jnp.zeros((N_GLOBALS, *U.shape))
        columns = columns.at[varied].set(jax.vmap(by)(jnp.eye(N_GLOBALS)[varied]))
        columns = columns.at[2:8, :, 0].set(self.reference.rigid)
        border = Border(columns, self._rows(columns), self._corner(g))
        return SparseOperator(self.blocks(y), self.pattern, border)

    def _rows(self, columns):
        """Derivative of `_closures` by the nodal unknowns, from the gradients in `columns`."""
        area = jnp.where(self.fixed_area, columns[0, :, 0] / (4 * jnp.pi), 0.0)
        volume = jnp.where(self.fixed_volume, -columns[1, :, 0] / (4 * jnp.pi / 3), 0.0)
        first = jnp.stack([area, volume])
        by_s = jnp.concatenate([first, self.reference.rigid, self.path.shape[None]])
        return jnp.zeros_like(columns).at[:, :, 0].set(by_s)

    def _corner(self, g):
        """Derivative of `_closures` by the global unknowns."""
        free_area, free_volume = ~self.fixed_area, ~self.fixed_volume
        diagonal = jnp.concatenate(
            [
                jnp.stack([free_area, free_volume]).astype(float),
                jnp.full(6, -RIGID_SOFTNESS),
                self.path.weight[None],
            ]
        )
        d = self.path.direction
        by_area = jnp.where(free_area, d.tension, d.area / (4 * jnp.pi))
        by_volume = jnp.where(free_volume, d.pressure, d.volume / (4 * jnp.pi / 3))
        return jnp.diag(diagonal).at[:2, 8].add(-jnp.stack([by_area, by_volume]))

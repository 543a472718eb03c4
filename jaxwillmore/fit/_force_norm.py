r"""The norm in which forces on a surface are compared."""

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from ..fem import mass_and_stiffness, rule_for
from ..linalg import BlockPattern, SparseOperator, SparseSolver, block_pattern, scatter_blocks
from ..mesh import SurfaceMesh

# Waves longer than this part of R0 count with their force, shorter ones with the displacement
# that would balance it.
SMOOTHING_LENGTH = 0.5


class ForceNorm(eqx.Module):
    r"""$\|\ell^4 (1 - \ell^2\Delta)^{-2} f\|_{L^2}$ of a normal force density over κ.

    The second variation of the bending energy is $\kappa\Delta^2$ at short waves, so that
    $\ell^4 (1 - \ell^2\Delta)^{-2} f/\kappa$ is the displacement that would balance $f$: nodes with
    errors of equal size count equally, whatever the wavelength of the error. The L² norm of $f$
    itself would count it with the fourth power of its wave number.

    **Attributes:**

    - `mass`: the mass matrix M.
    - `smoother`: $M + \ell^2 S$ with the stiffness matrix S.
    - `length`: $\ell$.
    """

    mass: SparseOperator
    smoother: SparseOperator
    length: Float[Array, ""]

    def displacement(self, load: Float[Array, " nodes"]) -> Float[Array, " nodes"]:
        r"""The displacement that would balance a force, from its load vector $(f, \varphi_i)$."""
        return self.length**4 * self._smooth(self.mass.mv(self._smooth(load)))

    def inner(self, u: Float[Array, " nodes"], w: Float[Array, " nodes"]) -> Float[Array, ""]:
        """L² product of two displacements."""
        return jnp.sum(u * self.mass.mv(w))

    def dual(self, w: Float[Array, " nodes"]) -> Float[Array, " nodes"]:
        """The test function whose product with a load is `inner(w, displacement(load))`."""
        return self.displacement(self.mass.mv(w))

    def _smooth(self, load):
        solver = SparseSolver(rtol=1e-11, method="direct")
        return lx.linear_solve(self.smoother, load, solver, throw=False).value


def force_norm(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], radius: Float[Array, ""]
) -> ForceNorm:
    """The norm on a surface of the given size."""
    return _assembled(mesh, block_pattern(mesh.cells, mesh.n_nodes), x, SMOOTHING_LENGTH * radius)


@eqx.filter_jit
def _assembled(mesh: SurfaceMesh, pattern: BlockPattern, x, length) -> ForceNorm:
    local = mass_and_stiffness(mesh, rule_for(mesh, min(2 * mesh.degree + 2, 10)), x)
    M, S = (scatter_blocks(pattern, matrices[..., None, None]) for matrices in local)
    return ForceNorm(SparseOperator(M, pattern), SparseOperator(M + length**2 * S, pattern), length)

"""What stays while Newton's method runs: the reference surface and the path of parameters."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Rule
from ..linalg import BlockPattern
from ..mesh import SurfaceMesh
from ._parameters import Parameters


class Reference(eqx.Module):
    """The frozen surface that unknown normal displacements (and concentrations) refer to.

    **Attributes:**

    - `mesh`, `rule`, `pattern`: connectivity, quadrature and sparsity.
    - `X`, `n`: nodes and unit normals; the unknown surface has nodes `X + s n`.
    - `mass`, `stiffness`: entries of the matrices of `X` on the pattern.
    - `rigid`: six rows; their product with `s` is the rigid motion in it.
    - `c`, `rigid_c`: the concentration on `X`, if any, and six rows for what a change of it adds
      to the rigid motion.
    """

    mesh: SurfaceMesh
    rule: Rule
    pattern: BlockPattern
    X: Float[Array, "nodes 3"]
    n: Float[Array, "nodes 3"]
    mass: Float[Array, " blocks"]
    stiffness: Float[Array, " blocks"]
    rigid: Float[Array, "6 nodes"]
    c: Float[Array, " nodes"] | None = None
    rigid_c: Float[Array, "6 nodes"] | None = None

    @property
    def rigid_rows(self) -> Float[Array, "6 nodes fields"]:
        """The rows for all nodal unknowns."""
        rows = self.rigid[:, :, None] * jnp.array([[[1.0, 0.0, 0.0, 0.0]]])
        if self.rigid_c is None:
            return rows
        return jnp.concatenate([rows, self.rigid_c[:, :, None]], axis=2)

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

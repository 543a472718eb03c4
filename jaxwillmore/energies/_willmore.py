"""Willmore energy."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ..surface import mean_curvature_vector
from ._base import AbstractEnergy
from ._parameters import nodes_of


class Willmore(AbstractEnergy):
    r"""$E = \tfrac12\int |Y|^2$ with the weak mean curvature vector $Y$ of the nodes alone.

    8π on a sphere, 4π² on the Clifford torus; invariant under scaling. On degree 2 the error is of
    order 4, its first variation in a normal direction too.
    """

    def __call__(self, mesh, x, fields=None):
        x = nodes_of(mesh, x)
        Y = mean_curvature_vector(mesh, x)
        return 0.5 * integrate(mesh, x, lambda _, f: jnp.sum(f.Y.value**2), {"Y": Y})


def willmore_of_field(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], H: Float[Array, " nodes"]
) -> Float[Array, ""]:
    r"""$\tfrac12\int H_h^2$ of a mean curvature field.

    The field of a flow may drift away from the surface it lives on, even below the bound 8π; judge
    a shape by `Willmore`.
    """
    return 0.5 * integrate(mesh, x, lambda _, f: f.H.value**2, {"H": H})

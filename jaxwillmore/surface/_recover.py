"""Normal and mean curvature of a discrete surface from its nodes alone."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import load, project
from ..mesh import SurfaceMesh


# Compiled, because the solve of a projection would otherwise be compiled anew in every call.
@eqx.filter_jit
def recover_normal(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
    r"""Nodal unit normals: the L² projection of the element normals, normalised node by node.

    In L² the order is at least the degree; on smooth images of regular meshes it is 3.5 for degree
    2 and 1.5 for degree 1.
    """
    nu = project(mesh, x, load(mesh, x, lambda point, _, phi, __: phi * point.normal))
    return nu / jnp.linalg.norm(nu, axis=1, keepdims=True)


@eqx.filter_jit
def mean_curvature_vector(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
    r"""Weak mean curvature vector $Y \approx H\nu$: $(Y, \chi) = (\nabla x, \nabla\chi)$.

    Since $-\Delta_\Gamma x = H\nu$, this is the mean curvature that a finite element function can
    see; it depends on `x` alone.
    """
    # ∇x is the tangential projector, so (∇x, ∇χ e_i) is the i-th component of ∇χ.
    return project(mesh, x, load(mesh, x, lambda _, __, ___, grad: grad))


@eqx.filter_jit
def recover_mean_curvature(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, " nodes"]:
    r"""Nodal mean curvature $Y\cdot\nu$ from the weak mean curvature vector.

    Order 2 in L² for degree 2; on irregular meshes of degree 1 it does not converge pointwise.
    """
    Y = mean_curvature_vector(mesh, x)
    return jnp.sum(Y * recover_normal(mesh, x), axis=1)

r"""Errors of discrete surfaces and their fields against an exact surface."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ..surface import AbstractLevelSet

NAMES = ("x", "nu", "H")


@eqx.filter_jit
def surface_errors(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    nu: Float[Array, "nodes 3"],
    H: Float[Array, " nodes"],
    exact: AbstractLevelSet,
) -> dict[str, Float[Array, ""]]:
    r"""L² and H¹ norms over Γ_h of the errors of position, normal and mean curvature.

    True errors, by quadrature: at every quadrature point the exact values are taken at its
    projection p on the exact surface.

    - x: the signed distance d of Γ_h from Γ. $\nabla_{\Gamma_h} d$ is the part of the exact
      normal tangential to Γ_h, so the H¹ norm measures the angle between the normals. Where a node
      sits on the surface does not count.
    - ν: $\nu_h - \nu(p)$, with gradient $\nabla\nu_h - A(p) P_h$, $P_h = I - n_h n_h'$.
    - H: $H_h - H(p)$, with gradient $\nabla H_h - P_h \nabla_\Gamma H(p)$.

    Terms of second order (d times curvature) are left out of the lifted gradients.

    **Returns:** a dictionary with `x_l2`, `x_h1`, `nu_l2`, `nu_h1`, `H_l2`, `H_h1`.
    """

    def density(point, f):
        p = exact.project(point.position[None])
        nu, A = exact.normal(p)[0], exact.weingarten(p)[0]
        H, grad_H = exact.mean_curvature(p)[0], exact.mean_curvature_gradient(p)[0]
        n = point.normal
        P = jnp.eye(3) - jnp.outer(n, n)
        values = (jnp.dot(point.position - p[0], nu), f.nu.value - nu, f.H.value - H)
        gradients = (P @ nu, f.nu.grad - A @ P, f.H.grad - P @ grad_H)
        l2 = jnp.stack([jnp.sum(v**2) for v in values])
        return jnp.stack([l2, l2 + jnp.stack([jnp.sum(g**2) for g in gradients])])

    return _named(jnp.sqrt(integrate(mesh, x, density, {"nu": nu, "H": H})))


@eqx.filter_jit
def nodal_errors(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], errors: dict[str, Float[Array, "nodes ..."]]
) -> dict[str, Float[Array, ""]]:
    """L² and H¹ norms of finite element functions with the nodal values `errors`, by name."""

    def density(_, f):
        l2 = jnp.stack([jnp.sum(getattr(f, name).value ** 2) for name in NAMES])
        h1 = jnp.stack([jnp.sum(getattr(f, name).grad ** 2) for name in NAMES])
        return jnp.stack([l2, l2 + h1])

    return _named(jnp.sqrt(integrate(mesh, x, density, errors)))


def _named(norms: Float[Array, "2 3"]) -> dict[str, Float[Array, ""]]:
    return {
        f"{name}_{norm}": norms[i, k]
        for k, name in enumerate(NAMES)
        for i, norm in enumerate(("l2", "h1"))
    }

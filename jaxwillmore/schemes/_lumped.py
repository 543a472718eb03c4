"""Mass lumping on flat triangles: the quadrature rule at the vertices, and what follows from it."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Rule, gather, point, scatter_add
from ..mesh import SurfaceMesh
from ..reference import lagrange_basis, lagrange_gradients, lagrange_nodes


def vertex_rule(mesh: SurfaceMesh) -> Rule:
    r"""$(u, v)^h = \sum_T \frac{|T|}{3} \sum_{j \in T} (uv)|_T(p_j)$.

    With it mass matrices are diagonal, while products of gradients, constant on flat triangles,
    stay exact: one rule serves all terms of a lumped scheme.

    **Raises:** `ValueError` for curved triangles, where the rule is too poor.
    """
    if mesh.degree != 1:
        raise ValueError(
            f"Lumped schemes are made for flat triangles, degree 1; got degree {mesh.degree}."
        )
    corners = lagrange_nodes(1)
    values = lagrange_basis(1, corners)[..., None]
    phi = jnp.concatenate([values, lagrange_gradients(1, corners)], axis=-1)
    return Rule(jnp.full(3, 1 / 6), jnp.asarray(phi))


def vertex_geometry(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"]
) -> tuple[Float[Array, " nodes"], Float[Array, "nodes 3"], Float[Array, "nodes 3"]]:
    r"""Lumped mass $m_j$, $\omega_j = (\nu, \varphi_j)^h / m_j$ and $(\nabla x, \nabla\varphi_j)$.

    $\omega_j$ is the mean of the normals around vertex j weighted with area, not of unit length.
    """
    phi = vertex_rule(mesh).phi[0]

    def cell(x_T):
        X = x_T.T @ phi
        here = point(X[:, 0], X[:, 1:])
        third = here.dA / 6
        grad = 0.5 * here.dA * phi[:, 1:] @ here.lift.T
        return third * jnp.ones(3), third * jnp.ones((3, 1)) * here.normal[None, :], grad

    m, nu, stiff = (scatter_add(mesh, part) for part in jax.vmap(cell)(gather(mesh, x)))
    return m, nu / m[:, None], stiff


def lumped_mean_curvature(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, " nodes"]:
    r"""H of $(H\nu, \eta)^h = (\nabla x, \nabla\eta)$, tested with $\omega_j$ at vertex j alone."""
    m, omega, stiff = vertex_geometry(mesh, x)
    return jnp.sum(stiff * omega, axis=1) / (m * jnp.sum(omega * omega, axis=1))


def lumped_weingarten_squared(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], H: Float[Array, " nodes"]
) -> Float[Array, " nodes"]:
    r"""$|A|^2$ at the vertices, with the lumped weak Weingarten map of the normals of the triangles

    $$ (A, \zeta)^h = -(\nu, \nabla\cdot\zeta) + (H\nu, \zeta\nu)^h, $$

    integration by parts of $\int \nabla\nu : \zeta$; only its symmetric part counts.
    """
    phi = vertex_rule(mesh).phi[0]

    def cell(x_T, H_T):
        X = x_T.T @ phi
        here = point(X[:, 0], X[:, 1:])
        n, grad = here.normal, phi[:, 1:] @ here.lift.T
        part = -0.5 * jnp.einsum("i,lk->lik", n, grad)
        part = part + jnp.einsum("l,i,k->lik", H_T, n, n) / 6
        return here.dA * part, jnp.full(3, here.dA / 6)

    A, m = (scatter_add(mesh, a) for a in jax.vmap(cell)(gather(mesh, x), gather(mesh, H)))
    A = 0.5 * (A + jnp.swapaxes(A, 1, 2)) / m[:, None, None]
    return jnp.sum(A * A, axis=(1, 2))

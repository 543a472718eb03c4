r"""Gaussian curvature as a measure: inside the cells, along the edges and at the vertices.

A surface of curved triangles is smooth inside a cell, has a bend in its metric along an edge and a
cone at a vertex. All three carry curvature, and for a function $w$ on the nodes

$$ \int w\,\mathrm{d}K = \sum_T \Big( \int_T w K + \int_{\partial T} w\,k_g
   - \sum_{c \in T} w(c)\,\theta_c \Big) + 2\pi \sum_v w(v) $$

with the geodesic curvature $k_g$ of the edges and the angles $\theta$ of the corners. With the
frame $e_1 = \partial_1 x/|\partial_1 x|$, $e_2 = n \times e_1$, its connection form
$\omega = \langle \mathrm{d}e_1, e_2\rangle$ and the angle $\psi$ from $e_1$ to an edge,
$K\,\mathrm{d}A = -\mathrm{d}\omega$ and $k_g\,\mathrm{d}s = \mathrm{d}\psi + \omega$. Integrated by
parts, a cell contributes

$$ \int_T \mathrm{d}w \wedge \omega - \int_{\partial T} \psi\,\mathrm{d}w - \pi\,w(c_1), $$

in which a constant has the integral $2\pi\chi$ whatever the quadrature: Gauss–Bonnet to rounding.
"""

import functools as ft

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..fem import gather, project, scatter_add
from ..mesh import SurfaceMesh
from ..reference import lagrange_gradients, lagrange_nodes, quadrature


@ft.cache
def _cell_tables(degree: int):
    """Weights, first and second derivatives of the basis at points inside the triangle."""
    rule = quadrature(min(2 * degree + 2, 10))
    first = lagrange_gradients(degree, rule.points)
    # A derivative of the basis is a polynomial again: interpolate it and differentiate.
    at_nodes = lagrange_gradients(degree, lagrange_nodes(degree))
    return rule.weights, first, np.einsum("qmb,mja->qjab", first, at_nodes)


@ft.cache
def _edge_tables(degree: int):
    """Weights, and the derivatives of the basis along the edges 1→2 and 2→0."""
    s, weights = np.polynomial.legendre.leggauss(degree + 2)
    s = 0.5 * (s + 1)
    edge_12 = lagrange_gradients(degree, np.stack([1 - s, s], axis=1))
    edge_20 = lagrange_gradients(degree, np.stack([0 * s, 1 - s], axis=1))
    return 0.5 * weights, edge_12, edge_20


def _metric(J: Float[Array, "3 2"]):
    """|∂₁x|², ∂₁x·∂₂x and the area element."""
    a, b = J[:, 0], J[:, 1]
    cross = jnp.cross(a, b)
    return jnp.sum(a * a), jnp.sum(a * b), jnp.sqrt(jnp.sum(cross * cross))


def _connection(J: Float[Array, "3 2"], D: Float[Array, "3 2"]) -> Float[Array, "2"]:
    r"""$\omega_i = \langle\partial_i\partial_1 x, e_2\rangle/|\partial_1 x|$, `D` = ∂ᵢ∂₁x."""
    aa, ab, dA = _metric(J)
    return D.T @ (aa * J[:, 1] - ab * J[:, 0]) / (aa * dA)


def gaussian_curvature_load(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"]
) -> Float[Array, " nodes"]:
    r"""The vector $\int \varphi_i\,\mathrm{d}K$ over all basis functions.

    Its product with a nodal field $w$ is $\int w\,\mathrm{d}K$; its sum is $2\pi\chi$ to rounding.
    On degree 1 it is the angle defect $2\pi - \sum\theta$ of the vertices. Against a smooth $w$ the
    order on degree 2 is 4 on smooth images of regular meshes and 3 on others, for its first
    variation too. Differentiable in `x`.
    """
    weights, first, second = _cell_tables(mesh.degree)
    edge_weights, edge_12, edge_20 = _edge_tables(mesh.degree)

    def cell(X):
        def inside(weight, d, dd):
            omega = _connection(X.T @ d, X.T @ dd[:, 0])
            return weight * (d[:, 0] * omega[1] - d[:, 1] * omega[0])

        def along_12(weight, d):
            aa, ab, dA = _metric(X.T @ d)
            return weight * jnp.arctan2(dA, ab - aa) * (d[:, 1] - d[:, 0])

        def along_20(weight, d):
            # The angle less π: the difference is the integral of π dw, which the corners hold.
            _, ab, dA = _metric(X.T @ d)
            return -weight * jnp.arctan2(dA, ab) * d[:, 1]

        total = jnp.sum(jax.vmap(inside)(weights, first, second), axis=0)
        total -= jnp.sum(jax.vmap(along_12)(edge_weights, edge_12), axis=0)
        total -= jnp.sum(jax.vmap(along_20)(edge_weights, edge_20), axis=0)
        return total.at[1].add(-jnp.pi)

    curvature = scatter_add(mesh, jax.vmap(cell)(gather(mesh, x)))
    return curvature.at[: mesh.n_vertices].add(2 * jnp.pi)


# Compiled, because the solve of a projection would otherwise be compiled anew in every call.
@eqx.filter_jit
def recover_gaussian_curvature(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"]
) -> Float[Array, " nodes"]:
    r"""Nodal $K_h$ with $(K_h, \varphi) = \int\varphi\,\mathrm{d}K$ for all basis functions.

    $\int K_h = 2\pi\chi$ on every mesh. In L² the order on degree 2 is 2 on smooth images of
    regular meshes.

    *Limits:* on irregular meshes $K_h$ does not converge pointwise, only in integrals that are
    linear in it.
    """
    return project(mesh, x, gaussian_curvature_load(mesh, x)[:, None])[:, 0]

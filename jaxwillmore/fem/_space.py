"""The Lagrange space on a surface mesh: basis functions tabulated at quadrature points."""

import functools as ft

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ..reference import lagrange_basis, lagrange_gradients, quadrature, subdivided


class Rule(eqx.Module):
    r"""Quadrature weights and the tabulated basis.

    `phi[q, j]` holds $\varphi_j$, $\partial_1\varphi_j$, $\partial_2\varphi_j$ at point `q`.
    """

    weights: Float[Array, " points"]
    phi: Float[Array, "points local 3"]


@ft.cache
def _tables(degree: int, quadrature_degree: int, fine: bool) -> tuple[np.ndarray, np.ndarray]:
    rule = quadrature(quadrature_degree)
    rule = subdivided(rule) if fine else rule
    values = lagrange_basis(degree, rule.points)[..., None]
    return np.asarray(rule.weights), np.concatenate(
        [values, lagrange_gradients(degree, rule.points)], axis=-1
    )


def rule_for(
    mesh: SurfaceMesh, quadrature_degree: int | None = None, *, fine: bool = False
) -> Rule:
    """Tabulated basis of `mesh` at a quadrature rule.

    The default exactness is `2 degree`, the lowest that keeps the order of a mixed weak form with
    degree-`k` fields; energies and error norms ask for more. A `fine` rule is that on the quarters
    of each cell.
    """
    if quadrature_degree is None:
        quadrature_degree = 2 * mesh.degree
    weights, phi = _tables(mesh.degree, quadrature_degree, fine)
    return Rule(jnp.asarray(weights), jnp.asarray(phi))


def gather(mesh: SurfaceMesh, nodal: Float[Array, "nodes ..."]) -> Float[Array, "cells local ..."]:
    """Nodal values cell by cell."""
    return nodal[mesh.cells]


def scatter_add(
    mesh: SurfaceMesh, local: Float[Array, "cells local ..."]
) -> Float[Array, "nodes ..."]:
    """Sum of cell contributions at the nodes; the transpose of `gather`."""
    zero = jnp.zeros((mesh.n_nodes, *local.shape[2:]), local.dtype)
    return zero.at[mesh.cells].add(local)

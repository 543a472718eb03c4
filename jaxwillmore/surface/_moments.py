"""Numbers of a shape that do not see how it is meshed: curvature moments, centre, inertia."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ._measures import volume
from ._recover import mean_curvature_vector


def curvature_moments(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], powers: tuple[int, ...] = (1, 2, 3, 4)
) -> Float[Array, " powers"]:
    r"""$\int H^p$ for each power, length$^{2-p}$, from the weak mean curvature vector.

    $H = Y\cdot n_\Gamma$ at the quadrature points; order 4 on degree 2 for smooth meshes.

    **Raises:** `ValueError` unless the powers are non-negative integers.
    """
    if any(not isinstance(p, int) or p < 0 for p in powers):
        raise ValueError(f"`powers` must be non-negative integers; got {powers!r}.")
    Y = mean_curvature_vector(mesh, x)

    def density(point, f):
        H = jnp.sum(f.Y.value * point.normal)
        return jnp.stack([H**p for p in powers])

    return integrate(mesh, x, density, {"Y": Y})


def body_centroid(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "3"]:
    r"""Centre of the enclosed volume, $\frac{1}{4V}\int x\,(x\cdot\nu)$.

    By the divergence theorem $\int_\Omega f = \frac{1}{3+p}\int_\Gamma f\,x\cdot\nu$ for a
    homogeneous f of degree p. Exact for the discrete body up to degree 3. See `centroid` for the
    centre of the surface.
    """
    # Taken about the mean node, which loses no digits when the body is far from the origin.
    origin = jnp.mean(x, axis=0)

    def density(point, _):
        arm = point.position - origin
        return arm * jnp.sum(arm * point.normal) / 4

    first = integrate(mesh, x, density, quadrature_degree=min(4 * mesh.degree - 2, 10))
    return origin + first / volume(mesh, x)


def inertia_tensor(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "3 3"]:
    r"""Inertia tensor of the enclosed body of density one about its centre, length⁵.

    $\mathrm{tr}(S)\,I - S$ with $S = \int_\Omega r r' = \tfrac15\int_\Gamma r r'\,(r\cdot\nu)$.
    Exact for the discrete body up to degree 2.
    """
    centre = body_centroid(mesh, x)

    def density(point, _):
        r = point.position - centre
        return jnp.outer(r, r) * jnp.sum(r * point.normal) / 5

    S = integrate(mesh, x, density, quadrature_degree=min(5 * mesh.degree - 2, 10))
    return jnp.trace(S) * jnp.eye(3) - S


def principal_moments(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "3"]:
    r"""Eigenvalues of the inertia tensor, ascending: they do not see how the body is turned.

    *Limits:* where two of them coincide, as on bodies of revolution, only their sum has a
    derivative; there use invariants of `inertia_tensor`.
    """
    return jnp.linalg.eigvalsh(inertia_tensor(mesh, x))

"""Area, enclosed volume and what follows from them."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import integrate
from ..mesh import SurfaceMesh


def area(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
    r"""Surface area $|\Gamma|$, length². Its first variation is $\int H\,\nu\cdot\phi$."""
    return integrate(mesh, x, lambda point, _: jnp.ones(()))


def volume(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
    r"""Enclosed volume $\tfrac13\int x\cdot\nu$, length³; positive when ν points outward."""
    # The integrand is a polynomial of degree 3k - 2 on the reference triangle: exact.
    return integrate(
        mesh,
        x,
        lambda point, _: jnp.sum(point.position * point.normal) / 3.0,
        quadrature_degree=max(3 * mesh.degree - 2, 1),
    )


def centroid(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, "3"]:
    r"""Centre of area $\int x / |\Gamma|$."""
    return integrate(mesh, x, lambda point, _: point.position) / area(mesh, x)


def reduced_volume(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
    r"""$v = 6\sqrt\pi\,V_p / |\Gamma|^{3/2}$: 1 for a sphere, less for every other surface."""
    return 6 * jnp.sqrt(jnp.pi) * volume(mesh, x) / area(mesh, x) ** 1.5


def area_radius(mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
    r"""$R_0 = \sqrt{|\Gamma|/4\pi}$, the radius of the sphere of equal area."""
    return jnp.sqrt(area(mesh, x) / (4 * jnp.pi))

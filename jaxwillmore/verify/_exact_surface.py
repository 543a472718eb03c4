"""Surfaces known twice, as a level set and by charts, with quadrature that does not see a mesh."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import Nodes
from ..fem import Jet
from ..mesh import SurfaceMesh, from_sphere_map, from_torus_map
from ..surface import AbstractLevelSet, Ellipsoid, LevelSet, Torus

Field = Callable[[Float[Array, "3"]], Float[Array, ""]]
Generator = Callable[[int, int], tuple[SurfaceMesh, Nodes]]


class ExactSurface(eqx.Module):
    r"""A closed surface by a level set, by charts, and as a generator of meshes.

    Integrals use the trapezoidal rule in periodic angles and Gauss's rule in the height on a
    sphere: their error falls faster than any power of the number of points.

    **Attributes:**

    - `level_set`: where normals and curvatures come from, by differentiation of F.
    - `chart`: `(base, uv) -> point`, a parametrisation around each base point, $uv = 0$ there;
      $X_u \times X_v$ points outward.
    - `bases`, `weights`: quadrature of the parameter domain.
    - `generate`: `(level, degree) -> (mesh, x)` with all nodes on the surface.
    """

    name: str = eqx.field(static=True)
    level_set: AbstractLevelSet
    chart: Callable = eqx.field(static=True)
    bases: Float[Array, "points parameters"]
    weights: Float[Array, " points"]
    generate: Generator = eqx.field(static=True)

    def points(self) -> tuple[Float[Array, "points 3"], Float[Array, " points"]]:
        """Quadrature points on the surface, and their weights as areas."""

        def at(base, weight):
            X, tangents = self.chart(base, jnp.zeros(2)), jax.jacfwd(self.chart, 1)
            T = tangents(base, jnp.zeros(2))
            return X, weight * jnp.linalg.norm(jnp.cross(T[:, 0], T[:, 1]))

        return jax.vmap(at)(self.bases, self.weights)

    def jet(self, field: Field, p: Float[Array, "3"]) -> Jet:
        """Value and tangential gradient of a function of space at a point of the surface."""
        value, gradient = jax.value_and_grad(field)(p)
        nu = self.level_set.normal(p[None])[0]
        return Jet(value, gradient - jnp.dot(gradient, nu) * nu)

    def laplacian(self, field: Field, p: Float[Array, "3"]) -> Float[Array, ""]:
        r"""$\Delta_\Gamma u = \mathrm{tr} D^2u - \nu\cdot D^2u\,\nu - H\,\partial_\nu u$."""
        nu, H = self.level_set.normal(p[None])[0], self.level_set.mean_curvature(p[None])[0]
        D2 = jax.hessian(field)(p)
        return jnp.trace(D2) - nu @ D2 @ nu - H * jnp.dot(jax.grad(field)(p), nu)


def sphere_like(name: str, f: Callable, level_set: AbstractLevelSet, n: int = 48) -> ExactSurface:
    """The image of the unit sphere under `f`; `n` Gauss points in the height, `2n` angles."""
    heights, weights = np.polynomial.legendre.leggauss(n)
    angles = 2 * np.pi * np.arange(2 * n) / (2 * n)
    z, phi = (a.ravel() for a in np.meshgrid(heights, angles, indexing="ij"))
    rho = np.sqrt(1 - z**2)
    bases = np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1)

    def chart(base, uv):
        # Two tangents of the sphere; with its normal they are right-handed.
        axis = jnp.eye(3)[jnp.argmin(jnp.abs(base))]
        first = jnp.cross(axis, base)
        first = first / jnp.linalg.norm(first)
        moved = base + uv[0] * first + uv[1] * jnp.cross(base, first)
        return f(moved / jnp.linalg.norm(moved))

    return ExactSurface(
        name,
        level_set,
        chart,
        jnp.asarray(bases),
        jnp.asarray(np.repeat(weights * np.pi / n, 2 * n)),
        lambda level, degree: from_sphere_map(f, level, degree),
    )


def triaxial_ellipsoid() -> ExactSurface:
    """An ellipsoid with three different semi-axes 1, 1.2, 1.5."""
    axes = jnp.array([1.0, 1.2, 1.5])
    return sphere_like("ellipsoid", lambda n: axes * n, Ellipsoid(axes))


def round_torus(R: float = 1.0, r: float = 0.4) -> ExactSurface:
    """A torus of revolution on similar grids: 192, 768, 3,072 nodes at levels 1, 2, 3."""
    theta, phi = (a.ravel() for a in np.meshgrid(*(2 * np.pi * np.arange(m) / m for m in (24, 64))))

    def point(theta, phi):
        rho = R + r * jnp.cos(phi)
        return jnp.stack([rho * jnp.cos(theta), rho * jnp.sin(theta), r * jnp.sin(phi)])

    def generate(level, degree):
        n = 1 << level
        return from_torus_map(point, 6 * n, 2 * n, degree)

    return ExactSurface(
        "torus",
        Torus(R, r),
        lambda base, uv: point(base[0] + uv[0], base[1] + uv[1]),
        jnp.asarray(np.stack([theta, phi], axis=1)),
        jnp.full(theta.size, (2 * np.pi) ** 2 / theta.size),
        generate,
    )


def bumpy_surface() -> ExactSurface:
    """A star-shaped surface without any symmetry, genus 0."""

    def radius(n):
        return 1.0 + 0.15 * n[0] * n[1] + 0.12 * n[2] ** 3 - 0.1 * n[0] ** 2 * n[2] + 0.05 * n[1]

    def F(p):
        length = jnp.sqrt(jnp.sum(p * p))
        return length - radius(p / length)

    return sphere_like("bumpy", lambda n: radius(n) * n, LevelSet(F))

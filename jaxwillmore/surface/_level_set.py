"""Exact normals and curvatures of surfaces given as the zero set of a function."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._types import Nodes, Scalar

_MAX_NEWTON_STEPS = 50


def _length(value) -> Scalar:
    """A positive number, or any traced one, as a float64 scalar."""
    if not isinstance(value, Tracer):
        host = np.asarray(value)
        if host.shape != () or host.dtype.kind not in "iuf" or not 0 < host < np.inf:
            raise ValueError(f"A length of a level set must be positive and finite; got {value!r}.")
    return jnp.asarray(value, dtype=jnp.float64)


def _number(value) -> Scalar:
    return jnp.asarray(value, dtype=jnp.float64)


def _three_lengths(value) -> Float[Array, "3"]:
    if not isinstance(value, Tracer):
        host = np.asarray(value)
        if host.shape != (3,) or host.dtype.kind not in "iuf" or not np.all(host > 0):
            raise ValueError(f"`semi_axes` must be three positive lengths; got {value!r}.")
    return jnp.asarray(value, dtype=jnp.float64)


class AbstractLevelSet(eqx.Module):
    r"""A closed surface $\{F = 0\}$ with F < 0 inside; derivatives of F are made by JAX.

    A subclass says what F is at one point; everything else is here. All methods take points on
    the surface (or near it: then the answer belongs to the level set of F through that point).
    """

    @abc.abstractmethod
    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        """F at one point: smooth, with a gradient that does not vanish where F = 0."""

    @eqx.filter_jit
    def value(self, x: Nodes) -> Float[Array, " nodes"]:
        """F at every point."""
        return jax.vmap(self.__call__)(x)

    @eqx.filter_jit
    def normal(self, x: Nodes) -> Nodes:
        r"""The outward unit normal $\nu = \nabla F / |\nabla F|$."""
        return jax.vmap(self._normal)(x)

    @eqx.filter_jit
    def weingarten(self, x: Nodes) -> Float[Array, "nodes 3 3"]:
        r"""The Weingarten map $A = \nabla_\Gamma \nu = P \, D^2 F \, P / |\nabla F|$.

        P = I − νν'. Symmetric, with ν in its kernel; I − νν' on the unit sphere.
        """
        return jax.vmap(self._weingarten)(x)

    @eqx.filter_jit
    def mean_curvature(self, x: Nodes) -> Float[Array, " nodes"]:
        r"""$H = \kappa_1 + \kappa_2 = \mathrm{tr}\, A$; the sphere of radius R has 2/R."""
        return jax.vmap(self._mean_curvature)(x)

    @eqx.filter_jit
    def gaussian_curvature(self, x: Nodes) -> Float[Array, " nodes"]:
        r"""$K = \kappa_1 \kappa_2 = (H^2 - |A|^2) / 2$."""
        A = self.weingarten(x)
        H = jnp.trace(A, axis1=1, axis2=2)
        return 0.5 * (H**2 - jnp.sum(A**2, axis=(1, 2)))

    @eqx.filter_jit
    def mean_curvature_gradient(self, x: Nodes) -> Nodes:
        r"""The tangential gradient $\nabla_\Gamma H = z = \Delta_\Gamma \nu + |A|^2 \nu$."""

        def at_point(point):
            nu = self._normal(point)
            gradient = jax.grad(self._mean_curvature)(point)
            return gradient - jnp.dot(gradient, nu) * nu

        return jax.vmap(at_point)(x)

    @eqx.filter_jit
    def project(self, x: Nodes) -> Nodes:
        """Move points near the surface onto it, by Newton's method along the gradient of F.

        A point on the surface stays where it is. This is not the closest point, but its distance
        from it is of second order in the distance from the surface.

        **Raises:** a runtime error if a point is not on the surface after 50 steps; it was too far
        away, or the gradient of F vanishes on the way.

        **Limits:** not reverse-mode differentiable.
        """
        return jax.vmap(self._project)(x)

    def _normal(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        gradient = jax.grad(self.__call__)(point)
        return gradient / jnp.sqrt(jnp.dot(gradient, gradient))

    def _weingarten(self, point: Float[Array, "3"]) -> Float[Array, "3 3"]:
        gradient = jax.grad(self.__call__)(point)
        length = jnp.sqrt(jnp.dot(gradient, gradient))
        nu = gradient / length
        P = jnp.eye(3) - jnp.outer(nu, nu)
        return P @ jax.hessian(self.__call__)(point) @ P / length

    def _mean_curvature(self, point: Float[Array, "3"]) -> Scalar:
        return jnp.trace(self._weingarten(point))

    def _project(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        scale = jnp.max(jnp.abs(point))

        def newton_step(point):
            F, gradient = jax.value_and_grad(self.__call__)(point)
            square = jnp.dot(gradient, gradient)
            return -F * gradient / jnp.where(square > 0, square, 1.0)

        def is_moving(carry):
            _, step, count = carry
            return (jnp.max(jnp.abs(step)) > 4e-16 * scale) & (count < _MAX_NEWTON_STEPS)

        def advance(carry):
            point, step, count = carry
            point = point + step
            return point, newton_step(point), count + 1

        point, _, _ = jax.lax.while_loop(is_moving, advance, (point, newton_step(point), 0))
        F, gradient = jax.value_and_grad(self.__call__)(point)
        # Written so that a point that is not finite, or without a gradient, counts as failed.
        arrived = jnp.abs(F) <= 1e-12 * scale * jnp.sqrt(jnp.dot(gradient, gradient))
        return eqx.error_if(
            point, ~arrived, "`project` did not reach the surface. Start from points closer to it."
        )


class LevelSet(AbstractLevelSet):
    """The zero set of a function of one point, negative inside.

    ```python
    ball = jw.surface.LevelSet(lambda p: p[0] ** 2 + p[1] ** 2 + p[2] ** 2 - 1.0)
    ```
    """

    function: Callable[[Float[Array, "3"]], Scalar] = eqx.field(static=True)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        return self.function(point)


class Sphere(AbstractLevelSet):
    """A sphere about the origin: H = 2/radius."""

    radius: Scalar = eqx.field(default=1.0, converter=_length)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        return jnp.dot(point, point) - self.radius**2


class Ellipsoid(AbstractLevelSet):
    """x²/a² + y²/b² + z²/c² = 1 with `semi_axes` (a, b, c)."""

    semi_axes: Float[Array, "3"] = eqx.field(default=(1.0, 1.0, 2.0), converter=_three_lengths)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        return jnp.sum((point / self.semi_axes) ** 2) - 1.0


class Torus(AbstractLevelSet):
    """A torus of revolution about the z axis: (ρ − R)² + z² = r²."""

    major_radius: Scalar = eqx.field(default=1.0, converter=_length)
    minor_radius: Scalar = eqx.field(default=0.4, converter=_length)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        return (
            (_distance_from_axis(point) - self.major_radius) ** 2
            + point[2] ** 2
            - self.minor_radius**2
        )


class BeadsTorus(AbstractLevelSet):
    """A torus whose minor radius is `minor_radius + amplitude · sin(n_beads · θ)`."""

    major_radius: Scalar = eqx.field(default=1.0, converter=_length)
    minor_radius: Scalar = eqx.field(default=0.4, converter=_length)
    amplitude: Scalar = eqx.field(default=0.1, converter=_number)
    n_beads: int = eqx.field(default=6, static=True)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        on_axis = (point[0] == 0) & (point[1] == 0)
        theta = jnp.arctan2(point[1], jnp.where(on_axis, 1.0, point[0]))
        r = self.minor_radius + self.amplitude * jnp.sin(self.n_beads * theta)
        return (_distance_from_axis(point) - self.major_radius) ** 2 + point[2] ** 2 - r**2


class RedCell(AbstractLevelSet):
    """The biconcave disc z² = thickness² (1 − dimple · s²)² s with s = 1 − ρ²/radius²."""

    radius: Scalar = eqx.field(default=2.0, converter=_length)
    thickness: Scalar = eqx.field(default=1.0, converter=_length)
    dimple: Scalar = eqx.field(default=0.7, converter=_number)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        s = 1.0 - (point[0] ** 2 + point[1] ** 2) / self.radius**2
        return point[2] ** 2 - (self.thickness * (1.0 - self.dimple * s**2)) ** 2 * s


class EvansFung(AbstractLevelSet):
    """The red blood cell z² = ¼ (1 − q) (c0 + c2 q + c4 q²)² with q = ρ²/radius².

    ??? cite "Reference"
        Evans, Fung (1972), *Microvasc. Res.* 4, 335–347.
    """

    radius: Scalar = eqx.field(default=3.91, converter=_length)
    c0: Scalar = eqx.field(default=0.81, converter=_number)
    c2: Scalar = eqx.field(default=7.83, converter=_number)
    c4: Scalar = eqx.field(default=-4.39, converter=_number)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        q = (point[0] ** 2 + point[1] ** 2) / self.radius**2
        return point[2] ** 2 - 0.25 * (1.0 - q) * (self.c0 + self.c2 * q + self.c4 * q**2) ** 2


class Dumbbell(AbstractLevelSet):
    """The body y² + z² = (lobe · x² + neck)² (1 − x²) with two lobes along the x axis."""

    neck: Scalar = eqx.field(default=0.4, converter=_length)
    lobe: Scalar = eqx.field(default=0.6, converter=_number)

    def __call__(self, point: Float[Array, "3"]) -> Scalar:
        square = point[0] ** 2
        width = self.lobe * square + self.neck
        return point[1] ** 2 + point[2] ** 2 - width**2 * (1.0 - square)


def _distance_from_axis(point: Float[Array, "3"]) -> Scalar:
    square = point[0] ** 2 + point[1] ** 2
    return jnp.sqrt(jnp.where(square > 0, square, 1e-300))

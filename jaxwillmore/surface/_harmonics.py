"""Real spherical harmonics, and the coefficients of a star-shaped surface."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ._moments import body_centroid


def real_harmonics(max_degree: int, n: Float[Array, "3"]) -> Float[Array, " harmonics"]:
    r"""Orthonormal real spherical harmonics $Y_{lm}$ at a unit vector, at position $l^2 + l + m$.

    $m > 0$ goes with $\cos m\varphi$, $m < 0$ with $\sin|m|\varphi$; without the
    phase of Condon and Shortley. Polynomials in the components of `n`, by recurrence, and
    therefore smooth at the poles.

    **Raises:** `ValueError` if `max_degree` is negative.
    """
    if max_degree < 0:
        raise ValueError(f"`max_degree` must not be negative; got {max_degree}.")
    out = [jnp.zeros(())] * (max_degree + 1) ** 2
    cosine, sine, sectoral = jnp.ones(()), jnp.zeros(()), 1 / math.sqrt(4 * math.pi)
    for m in range(max_degree + 1):
        if m > 0:
            # (x + iy)^m = sin^m θ e^{imφ}
            cosine, sine = cosine * n[0] - sine * n[1], sine * n[0] + cosine * n[1]
            sectoral *= math.sqrt((2 * m + 1) / (2 * m))
        before, here = jnp.zeros(()), jnp.full((), sectoral)
        for degree in range(m, max_degree + 1):
            if degree > m:
                a = math.sqrt((4 * degree**2 - 1) / (degree**2 - m**2))
                b = math.sqrt(((degree - 1) ** 2 - m**2) / (4 * (degree - 1) ** 2 - 1))
                before, here = here, a * (n[2] * here - b * before)
            middle = degree * degree + degree
            if m == 0:
                out[middle] = here
            else:
                out[middle + m] = math.sqrt(2) * here * cosine
                out[middle - m] = math.sqrt(2) * here * sine
    return jnp.stack(out)


def harmonic_coefficients(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    max_degree: int,
    *,
    centre: Float[Array, "3"] | None = None,
) -> Float[Array, " harmonics"]:
    r"""Coefficients $c_{lm}$ of the radius $r(n) = \sum c_{lm} Y_{lm}(n)$ of a star-shaped surface.

    $$ c_{lm} = \int_{S^2} r\,Y_{lm} = \int_\Gamma |r|\,Y_{lm}(\hat r)\,\frac{r\cdot\nu}{|r|^3} $$

    An integral over the surface with the solid angle as weight: it does not see the nodes.
    Differentiable in `x` and `centre`.

    **Arguments:**

    - `max_degree`: the largest l; in the order of `real_harmonics`.
    - `centre`: where r starts; the centre of the enclosed volume if left out.

    **Raises:** a runtime error if some ray from the centre does not leave through the surface:
    it is not star-shaped. Give another `centre`.
    """
    centre = body_centroid(mesh, x) if centre is None else centre
    c, star_shaped = radial_coefficients(mesh, x, max_degree, centre)
    return eqx.error_if(
        c,
        ~star_shaped,
        "The surface is not star-shaped about `centre`, so it has no radius. Give a `centre` from "
        "which the whole surface is seen.",
    )


def radial_coefficients(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], max_degree: int, centre: Float[Array, "3"]
) -> tuple[Float[Array, " harmonics"], Bool[Array, ""]]:
    """As `harmonic_coefficients`, and whether they mean anything: whether it is star-shaped."""

    def density(point, _):
        r = point.position - centre
        length = jnp.sqrt(jnp.sum(r * r))
        outward = jnp.sum(r * point.normal)
        c = real_harmonics(max_degree, r / length) * outward / length**2
        return jnp.append(c, jnp.where(outward > 0, 0.0, 1.0))

    # On 80 cells of a prolate of axes 1 : 2 the plain rule of degree 10 gives l = 12 an error of
    # 3 % of the radius; quarters of the cells leave 1e-4.
    found = integrate(mesh, x, density, quadrature_degree=10, fine=True)
    return found[:-1], found[-1] == 0


def harmonic_power(c: Float[Array, " harmonics"]) -> Float[Array, " degrees"]:
    r"""$\sum_m c_{lm}^2$ for each l: it does not see how the surface is turned."""
    max_degree = math.isqrt(c.shape[0]) - 1
    return jnp.stack([jnp.sum(c[k * k : (k + 1) ** 2] ** 2) for k in range(max_degree + 1)])

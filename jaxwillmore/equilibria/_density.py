r"""The mixed functional at one quadrature point, and its derivatives there.

Everything is dimensionless: lengths in units of the size of the surface, energies in units of
$\kappa = 2 b_b$. A membrane with a concentration has the jet of $c$ among its arguments.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import EnergyForm, Jet, Layout, Rule, point, quadrature_sum, trace
from ..mesh import SurfaceMesh
from ._parameters import Parameters, moduli, phases_of

# Order of the global unknowns: tension, pressure, curvature multiplier, six rigid ones, with a
# concentration the chemical potential, and last the path parameter.
TENSION, PRESSURE, CURVATURE, RIGID, POTENTIAL, PATH = 0, 1, 2, slice(3, 9), 9, -1


def density(
    P: Float[Array, "fields 3"], p: Parameters, g: Float[Array, " globals"]
) -> Float[Array, ""]:
    r"""The functional at one point, times the area element.

    $$ \nabla_\Gamma\cdot y - \hat H_0\, y\cdot\nu - \frac{|y|^2}{2\kappa}
        + \frac\kappa2 (H_0^2 - \hat H_0^2) + \sigma - \tfrac13 P\, x\cdot\nu
        + \Psi(c) + \tfrac\gamma2|\nabla_\Gamma c|^2 - \mu c,
       \qquad \hat H_0 = H_0 - \frac m\kappa $$

    with $\kappa(c)$ and $H_0(c)$. Integrated and maximised over $y$ it becomes
    $\int \frac\kappa2 (H - H_0)^2 + m H + \sigma + \Psi + \tfrac\gamma2|\nabla c|^2 - \mu c
    \;-\; P V_p$, with $y = \kappa (H - \hat H_0)\nu$, since
    $\int \nabla_\Gamma\cdot y = \int H y\cdot\nu$ on a closed surface. No second derivative
    appears.

    **Arguments:**

    - `P`: value and two reference derivatives of the components of $x$, $y$ and, if any, $c$.
    - `p`: dimensionless parameters.
    - `g`: the global unknowns $\sigma$, $P$, $m$ and $\mu$ among them.
    """
    here = point(P[:3, 0], P[:3, 1:])
    y, grad_y = P[3:6, 0], P[3:6, 1:] @ here.lift.T
    c = None if p.two_phase is None else Jet(P[6, 0], P[6, 1:] @ here.lift.T)
    kappa, H0 = moduli(p, None if c is None else c.value)
    shifted = H0 - g[CURVATURE] / kappa
    bending = trace(grad_y) - shifted * jnp.sum(y * here.normal) - jnp.sum(y * y) / (2 * kappa)
    tension = g[TENSION] + kappa / 2 * (H0**2 - shifted**2)
    work = tension - g[PRESSURE] * jnp.sum(here.position * here.normal) / 3
    if c is not None:
        work = work + phases_of(p).mixing(c) - g[POTENTIAL] * c.value
    return here.dA * (bending + work)


def _of_all(P, args) -> Float[Array, ""]:
    return density(P, *args)


ONE_PHASE = EnergyForm(_of_all, Layout(("x", "y"), (3, 3)))
TWO_PHASES = EnergyForm(_of_all, Layout(("x", "y", "c"), (3, 3, 1)))


def integral(mesh: SurfaceMesh, rule: Rule, fields, p: Parameters, g) -> Float[Array, ""]:
    """Integral of `density`; `fields` are the nodal components of $x$, $y$ and, if any, $c$."""
    return quadrature_sum(mesh, rule, fields, lambda P: density(P, p, g))


def mixing(mesh: SurfaceMesh, rule: Rule, x, c, p: Parameters) -> Float[Array, ""]:
    r"""$\int \Psi(c) + \tfrac\gamma2|\nabla_\Gamma c|^2$."""

    def at(P):
        here = point(P[:3, 0], P[:3, 1:])
        return here.dA * phases_of(p).mixing(Jet(P[3, 0], P[3, 1:] @ here.lift.T))

    return quadrature_sum(mesh, rule, _with(x, c), at)


@eqx.filter_jit
def area_and_volume(mesh: SurfaceMesh, rule: Rule, x: Float[Array, "nodes 3"]):
    """Area and enclosed volume by the quadrature of the functional."""

    def at(X):
        cross = jnp.cross(X[:, 1], X[:, 2])
        return jnp.stack([jnp.linalg.norm(cross), jnp.sum(X[:, 0] * cross) / 3])

    both = quadrature_sum(mesh, rule, x, at)
    return both[0], both[1]


@eqx.filter_jit
def amount_of(mesh: SurfaceMesh, rule: Rule, x: Float[Array, "nodes 3"], c: Float[Array, " nodes"]):
    r"""$\int c$ by the quadrature of the functional."""

    def at(P):
        return P[3, 0] * jnp.linalg.norm(jnp.cross(P[:3, 1], P[:3, 2]))

    return quadrature_sum(mesh, rule, _with(x, c), at)


def _with(x, c):
    return jnp.concatenate([x, c[:, None]], axis=1)

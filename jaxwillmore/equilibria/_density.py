r"""The mixed functional at one quadrature point, and its derivatives there.

Everything is dimensionless: lengths in units of the size of the surface, energies in units of
$\kappa = 2 b_b$. A membrane with a concentration has the jet of $c$ among its arguments.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet, Rule, gather, point, trace
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


def second_derivatives(P: Float[Array, "fields 3"], p: Parameters, g: Float[Array, " globals"]):
    r"""Second derivatives of `density` at one quadrature point.

    Only the two tangents and the jet of $c$ are differentiated twice: `density` is linear in the
    position and, but for $-|y|^2/2\kappa$, in the jet of $y$.

    **Returns:** the derivative of the gradient by the jet of $x$, of shape `(fields, 3, 3, 3)`;
    that by the jet of $c$, of shape `(fields, 3, 3)`, or `None`; and the one number on the diagonal
    of the derivative by the value of $y$ twice.
    """

    def gradient(J, c):
        jets = [jnp.concatenate([P[:3, :1], J], axis=1), P[3:6]]
        jets += [] if c is None else [c[None]]
        return jax.grad(density)(jnp.concatenate(jets), p, g)

    J, c = P[:3, 1:], None if p.two_phase is None else P[6]
    by_J, by_c = jax.jacfwd(gradient, argnums=0)(J, c), None
    if c is not None:
        by_c = jax.jacfwd(gradient, argnums=1)(J, c)
    of_position = jnp.moveaxis(by_J[:3, 0], 0, -1)  # by a tangent and the position
    by_position = jnp.concatenate([jnp.zeros((3, 1, 3)), of_position], axis=1)
    by_position = jnp.concatenate([by_position, jnp.zeros((len(P) - 3, 3, 3))])
    by_x = jnp.concatenate([by_position[..., None], by_J], axis=3)
    kappa, _ = moduli(p, None if c is None else c[0])
    return by_x, by_c, -jnp.linalg.norm(jnp.cross(J[:, 0], J[:, 1])) / kappa


def integral(mesh: SurfaceMesh, rule: Rule, fields, p: Parameters, g) -> Float[Array, ""]:
    """Integral of `density`; `fields` are the nodal components of $x$, $y$ and, if any, $c$."""

    def cell(local):
        def at(phi, weight):
            return weight * density(local.T @ phi, p, g)

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights))

    return jnp.sum(jax.vmap(cell)(gather(mesh, fields)))


def mixing(mesh: SurfaceMesh, rule: Rule, x, c, p: Parameters) -> Float[Array, ""]:
    r"""$\int \Psi(c) + \tfrac\gamma2|\nabla_\Gamma c|^2$."""

    def cell(local):
        def at(phi, weight):
            P = local.T @ phi
            here = point(P[:3, 0], P[:3, 1:])
            jet = Jet(P[3, 0], P[3, 1:] @ here.lift.T)
            return weight * here.dA * phases_of(p).mixing(jet)

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights))

    return jnp.sum(jax.vmap(cell)(gather(mesh, jnp.concatenate([x, c[:, None]], axis=1))))


@eqx.filter_jit
def area_and_volume(mesh: SurfaceMesh, rule: Rule, x: Float[Array, "nodes 3"]):
    """Area and enclosed volume by the quadrature of the functional."""

    def cell(x_T):
        def at(phi, weight):
            X = x_T.T @ phi
            cross = jnp.cross(X[:, 1], X[:, 2])
            return weight * jnp.stack([jnp.linalg.norm(cross), jnp.sum(X[:, 0] * cross) / 3])

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights), axis=0)

    both = jnp.sum(jax.vmap(cell)(gather(mesh, x)), axis=0)
    return both[0], both[1]


@eqx.filter_jit
def amount_of(mesh: SurfaceMesh, rule: Rule, x: Float[Array, "nodes 3"], c: Float[Array, " nodes"]):
    r"""$\int c$ by the quadrature of the functional."""

    def cell(local):
        def at(phi, weight):
            P = local.T @ phi
            return weight * P[3, 0] * jnp.linalg.norm(jnp.cross(P[:3, 1], P[:3, 2]))

        return jnp.sum(jax.vmap(at)(rule.phi, rule.weights))

    return jnp.sum(jax.vmap(cell)(gather(mesh, jnp.concatenate([x, c[:, None]], axis=1))))

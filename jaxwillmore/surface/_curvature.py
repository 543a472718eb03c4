"""Curvatures from a normal field and its gradient."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet, inner, load, sym, trace
from ..mesh import SurfaceMesh


def weingarten(nu: Jet) -> Float[Array, "3 3"]:
    r"""$A = \mathrm{sym}\,\nabla_\Gamma\nu$; $\nabla_{\Gamma_h}\nu_h$ itself is not symmetric."""
    return sym(nu.grad)


def gaussian_curvature(A: Float[Array, "3 3"]) -> Float[Array, ""]:
    r"""$K = \kappa_1\kappa_2 = \tfrac12 ((\mathrm{tr} A)^2 - |A|^2)$."""
    return 0.5 * (trace(A) ** 2 - inner(A, A))


def principal_curvatures(
    H: Float[Array, ""], A_squared: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""$\kappa_1 \ge \kappa_2$ from their sum $H$ and the sum of their squares $|A|^2$."""
    discriminant = 2 * A_squared - H**2
    # At umbilic points the difference vanishes and its root has no derivative; guard before.
    safe = jnp.where(discriminant > 0, discriminant, 1.0)
    gap = jnp.where(discriminant > 0, jnp.sqrt(safe), 0.0)
    return 0.5 * (H + gap), 0.5 * (H - gap)


def nodal_weingarten_squared(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], nu: Float[Array, "nodes 3"]
) -> Float[Array, " nodes"]:
    r"""$|A_h|^2$ averaged around every node with the positive weights $\varphi_i^2$.

    $A_h$ is discontinuous across edges, and its L² projection may be negative on degree 2; this
    mean never is.
    """

    def density(_, jets, phi, __):
        A = weingarten(jets.nu)
        return phi**2 * jnp.stack([inner(A, A), jnp.ones(())])

    sums = load(mesh, x, density, {"nu": nu})
    return sums[:, 0] / sums[:, 1]

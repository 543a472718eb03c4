"""Canham–Helfrich energy with constant coefficients."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import integrate
from ..surface import mean_curvature_vector
from ._base import AbstractEnergy
from ._parameters import finite, positive


class CanhamHelfrich(AbstractEnergy):
    r"""$E = \int b_b (H - H_0)^2 + b_k K$ from the weak mean curvature vector of the nodes.

    With $Y \approx H\nu$: $\int b_b (|Y|^2 - 2 H_0\,Y\cdot n_\Gamma + H_0^2)$. On a closed surface
    $\int K = 2\pi\chi$, so that a constant $b_k$ adds the constant $2\pi\chi\,b_k$.

    **Arguments:**

    - `bending_modulus`: $b_b$, energy; $\kappa/2$ in the physicists' convention.
    - `gaussian_modulus`: $b_k$, energy.
    - `spontaneous_curvature`: $H_0$, 1/length, for the sum of the principal curvatures.
    """

    bending_modulus: Float[Array, ""]
    gaussian_modulus: Float[Array, ""]
    spontaneous_curvature: Float[Array, ""]

    def __init__(self, bending_modulus=0.5, gaussian_modulus=0.0, spontaneous_curvature=0.0):
        self.bending_modulus = positive("bending_modulus", bending_modulus)
        self.gaussian_modulus = finite("gaussian_modulus", gaussian_modulus)
        self.spontaneous_curvature = finite("spontaneous_curvature", spontaneous_curvature)

    def __call__(self, mesh, x):
        Y = mean_curvature_vector(mesh, x)
        H0 = self.spontaneous_curvature

        def density(point, f):
            Y = f.Y.value
            return jnp.sum(Y**2) - 2 * H0 * jnp.sum(Y * point.normal) + H0**2

        bending = self.bending_modulus * integrate(mesh, x, density, {"Y": Y})
        return bending + 2 * jnp.pi * mesh.euler_characteristic * self.gaussian_modulus

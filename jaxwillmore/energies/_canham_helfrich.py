"""Canham–Helfrich energy; its parameters are numbers or live on the nodes."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import integrate
from ..mesh import SurfaceMesh
from ..surface import gaussian_curvature_load, mean_curvature_vector
from ._base import AbstractEnergy
from ._parameters import finite_field, on_nodes, positive_field


class CanhamHelfrich(AbstractEnergy):
    r"""$E = \int b_b (H - H_0)^2 + b_k K$ from the weak mean curvature vector of the nodes.

    With $Y \approx H\nu$: $\int b_b (|Y|^2 - 2 H_0\,Y\cdot n_\Gamma + H_0^2)$. Every parameter is a
    number, or a field with one number for every node. $\int b_k K$ comes from
    `surface.gaussian_curvature_load`: a constant $b_k$ adds the constant $2\pi\chi\,b_k$
    (Gauss–Bonnet), and a field acts by its gradient alone.

    **Arguments:**

    - `bending_modulus`: $b_b$, energy; $\kappa/2$ in the physicists' convention, see `from_kappa`.
    - `gaussian_modulus`: $b_k$, energy.
    - `spontaneous_curvature`: $H_0$, 1/length, for the sum of the principal curvatures.

    **Raises:** `ValueError` for a parameter that is not finite, a bending modulus that is not
    positive, and, when called, for a field that does not have one number for every node.

    ```python
    soft = jnp.where(x[:, 2] > 0, 0.2, 0.5)
    energy = jw.energies.CanhamHelfrich(soft, spontaneous_curvature=1.0)
    value = energy(mesh, x)
    ```
    """

    # No shape in the annotation: a number, or one for every node, each on its own.
    bending_modulus: Float[Array, "..."]
    gaussian_modulus: Float[Array, "..."]
    spontaneous_curvature: Float[Array, "..."]

    def __init__(
        self,
        bending_modulus: Any = 0.5,
        gaussian_modulus: Any = 0.0,
        spontaneous_curvature: Any = 0.0,
    ):
        self.bending_modulus = positive_field("bending_modulus", bending_modulus)
        self.gaussian_modulus = finite_field("gaussian_modulus", gaussian_modulus)
        self.spontaneous_curvature = finite_field("spontaneous_curvature", spontaneous_curvature)

    @classmethod
    def from_kappa(
        cls, kappa, gaussian_modulus: Any = 0.0, spontaneous_curvature: Any = 0.0
    ) -> "CanhamHelfrich":
        r"""$\int \tfrac\kappa2 (H - H_0)^2 + \bar\kappa K$ as physicists write it: $b_b=\kappa/2$.

        $H = \kappa_1 + \kappa_2$ as everywhere; for the mean $\bar H = H/2$ with $\bar H_0$ give
        `spontaneous_curvature` $= 2\bar H_0$.
        """
        kappa = positive_field("kappa", kappa)
        return cls(0.5 * kappa, gaussian_modulus, spontaneous_curvature)

    def __call__(self, mesh, x):
        bending, b_k = self._bending(mesh, x, 1.0), self.gaussian_modulus
        if b_k.ndim == 0:
            return bending + 2 * jnp.pi * mesh.euler_characteristic * b_k
        return bending + self._gaussian(mesh, x, b_k)

    def scale(self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Float[Array, ""]:
        r"""$\int b_b (|Y|^2 + H_0^2) + |\int (b_k - \bar b_k) K|$: what the energy is made of.

        Where $H \approx H_0$ the energy vanishes while its terms do not, and the errors of the
        discretisation are relative to them. The mean $\bar b_k$ adds nothing but a constant.
        """
        bending, b_k = self._bending(mesh, x, 0.0), self.gaussian_modulus
        if b_k.ndim == 0:
            return bending
        return bending + jnp.abs(self._gaussian(mesh, x, b_k - jnp.mean(b_k)))

    def _bending(self, mesh, x, mixed: float) -> Float[Array, ""]:
        r"""$\int b_b (|Y|^2 - 2 m H_0\,Y\cdot n_\Gamma + H_0^2)$, m for `mixed`."""
        Y = mean_curvature_vector(mesh, x)
        fields = {
            "b_b": on_nodes("bending_modulus", self.bending_modulus, mesh),
            "H0": on_nodes("spontaneous_curvature", self.spontaneous_curvature, mesh),
        }

        def density(point, f):
            Y, H0 = f.Y.value, f.H0.value
            square = jnp.sum(Y**2) - 2 * mixed * H0 * jnp.sum(Y * point.normal) + H0**2
            return f.b_b.value * square

        return integrate(mesh, x, density, {"Y": Y, **fields})

    def _gaussian(self, mesh, x, b_k) -> Float[Array, ""]:
        b_k = on_nodes("gaussian_modulus", b_k, mesh)
        return jnp.vdot(b_k, gaussian_curvature_load(mesh, x))

"""The energy of a membrane of two phases."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet
from ..mesh import SurfaceMesh
from ._base import AbstractEnergy
from ._canham_helfrich import PARAMETERS, CanhamHelfrich
from ._parameters import nodes_of
from ._phase import GinzburgLandau
from ._wells import AbstractWell


class TwoPhase(AbstractEnergy):
    r"""Canham–Helfrich–Ginzburg–Landau energy of a membrane with a concentration $c$.

    $$ E = \int b_b(c) (H - H_0(c))^2 + b_k(c) K + \Psi(c) + \tfrac\gamma2|\nabla_\Gamma c|^2 $$

    The sum of its `bending` (`CanhamHelfrich`) and its `mixing` (`GinzburgLandau`), which say what
    their parameters mean. The energy reads `fields["c"]`.

    **Arguments:**

    - `bending_modulus`, `spontaneous_curvature`, `gaussian_modulus`: $b_b$, $H_0$, $b_k$; each a
      number, one number for every node, a `Mixture`, or another function of $c$.
    - `line_tension`, `interface_width`: $\lambda$ and $\ell$ of a `QuarticWell`.
    - `well`: another `AbstractWell`, in place of the two.

    **Raises:** `ValueError` for parameters out of their range, and when called without a
    concentration.

    ```python
    energy = jw.energies.TwoPhase(
        jw.energies.Mixture(0.5, 1.0), line_tension=4.0, interface_width=0.15
    )
    value = energy(mesh, x, {"c": c})
    ```

    ??? cite "Reference"
        Elliott, Stinner (2010), *J. Comput. Phys.* 229, 6585–6612.
    """

    bending: CanhamHelfrich
    mixing: GinzburgLandau

    def __init__(
        self,
        bending_modulus: Any = 0.5,
        spontaneous_curvature: Any = 0.0,
        gaussian_modulus: Any = 0.0,
        line_tension=None,
        interface_width=None,
        well: AbstractWell | None = None,
    ):
        self.bending = CanhamHelfrich(bending_modulus, gaussian_modulus, spontaneous_curvature)
        self.mixing = GinzburgLandau(line_tension, interface_width, well=well)

    @property
    def well(self) -> AbstractWell:
        r"""$\Psi$ and $\gamma$."""
        return self.mixing.well

    @property
    def bending_parameters(self) -> dict[str, Any]:
        """The three moduli by name: arrays, or functions of the concentration."""
        return {name: getattr(self.bending, name) for name in PARAMETERS}

    def __call__(self, mesh, x, fields=None):
        parts = self.parts(mesh, nodes_of(mesh, x), fields)
        return sum(parts.values(), start=jnp.zeros(()))

    def parts(
        self,
        mesh: SurfaceMesh,
        x: Float[Array, "nodes 3"],
        fields: Mapping[str, Array] | None = None,
    ) -> dict[str, Float[Array, ""]]:
        r"""Its terms `bending`, `gaussian`, and `phase`: $\int\Psi + \tfrac\gamma2|\nabla c|^2$."""
        return self.bending.parts(mesh, x, fields) | {"phase": self.mixing(mesh, x, fields)}

    def scale(self, mesh, x, fields=None):
        """The sizes of all terms, added."""
        return self.bending.scale(mesh, x, fields) + self.mixing.scale(mesh, x, fields)

    def density(
        self,
        c: Jet,
        H: Float[Array, ""],
        K: Float[Array, ""],
        nodal: Mapping[str, Jet] | None = None,
    ) -> Float[Array, ""]:
        r"""$b_b(c)(H - H_0(c))^2 + b_k(c)K + \Psi(c) + \tfrac\gamma2|\nabla c|^2$ at one point.

        Its derivatives by $c$ and $\nabla c$ make the chemical potential. `nodal` as in
        `CanhamHelfrich.density`.
        """
        return self.bending.density(c, H, K, nodal) + self.mixing.density(c)

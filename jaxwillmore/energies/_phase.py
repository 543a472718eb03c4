"""Energies of a concentration on the surface."""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._functions import as_data
from ..fem import Jet, inner, integrate
from ._base import AbstractEnergy
from ._parameters import density_of, nodes_of
from ._wells import AbstractWell, QuarticWell


class GinzburgLandau(AbstractEnergy):
    r"""$\int \Psi(c) + \tfrac\gamma2|\nabla_\Gamma c|^2$: two phases and the line between them.

    For a thin interface $\lambda$ times its length. The energy reads `fields["c"]`.

    **Arguments:**

    - `line_tension`, `interface_width`: of a `QuarticWell`, energy/length and length.
    - `well`: another `AbstractWell`, in place of the two.

    **Raises:** `ValueError` unless there is either one or the other, and when called without a
    concentration.

    ```python
    energy = jw.energies.GinzburgLandau(line_tension=1.0, interface_width=0.1)
    value = energy(mesh, x, {"c": c})
    ```
    """

    well: AbstractWell

    def __init__(
        self, line_tension=None, interface_width=None, *, well: AbstractWell | None = None
    ):
        pair = line_tension is not None, interface_width is not None
        if well is None and all(pair):
            self.well = QuarticWell(line_tension, interface_width)
        elif well is not None and not any(pair):
            self.well = well
        else:
            raise ValueError("Give `line_tension` and `interface_width`, or a `well` instead.")

    def __call__(self, mesh, x, fields=None):
        x, c = nodes_of(mesh, x), density_of(mesh, fields, "GinzburgLandau")
        return _integral(mesh, x, lambda _, f: self.density(f.c), {"c": c})

    def scale(self, mesh, x, fields=None):
        r"""$\int |\Psi| + \tfrac\gamma2|\nabla c|^2$."""
        x, c = nodes_of(mesh, x), density_of(mesh, fields, "GinzburgLandau")

        def size(_, f):
            steep = 0.5 * self.well.gradient_coefficient * inner(f.c.grad, f.c.grad)
            return jnp.abs(self.well.potential(f.c.value)) + jnp.abs(steep)

        return _integral(mesh, x, size, {"c": c})

    def density(self, c: Jet) -> Float[Array, ""]:
        r"""$\Psi(c) + \tfrac\gamma2|\nabla c|^2$ at one point, energy/length²."""
        return self.well.density(c)

    def scaled(self, factor) -> "GinzburgLandau":
        """A multiple of it, by its parameters."""
        return GinzburgLandau(well=self.well.scaled(factor))


class FreeEnergy(AbstractEnergy):
    r"""$\int G(u)$ of a density $u$ that the surface carries; the energy reads `fields["u"]`.

    **Arguments:**

    - `function`: $G$, energy/length², a function of one number. Give an `eqx.Module` to keep its
      parameters differentiable.

    **Raises:** `ValueError` when called without the density.
    """

    function: Callable[[Float[Array, ""]], Float[Array, ""]]

    def __init__(self, function):
        self.function = as_data(function)

    def __call__(self, mesh, x, fields=None):
        x, u = nodes_of(mesh, x), density_of(mesh, fields, "FreeEnergy", "u")
        return _integral(mesh, x, lambda _, f: self.function(f.u.value), {"u": u})


def _integral(mesh, x, density, fields) -> Float[Array, ""]:
    # The rule of the weak forms: a flow of c on a surface at rest then lowers exactly this number.
    # The next finer rule changes it by a tenth of the error of the mesh.
    return integrate(mesh, x, density, fields, quadrature_degree=2 * mesh.degree)

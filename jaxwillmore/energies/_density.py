"""Energies that a user writes as a density at one point of the surface."""

from collections.abc import Callable
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arguments import double
from .._functions import as_data
from ..fem import integrate
from ..surface import mean_curvature_vector, recover_gaussian_curvature
from ._base import AbstractEnergy
from ._parameters import nodes_of


class SurfacePoint(eqx.Module):
    r"""What a density may depend on at one quadrature point.

    **Attributes:**

    - `position`: the point.
    - `normal`: outward unit normal of the discrete surface.
    - `H`: mean curvature $\kappa_1 + \kappa_2$, from `surface.mean_curvature_vector`.
    - `K`: Gaussian curvature $\kappa_1\kappa_2$, from `surface.recover_gaussian_curvature`.
    """

    position: Float[Array, "3"]
    normal: Float[Array, "3"]
    H: Float[Array, ""]
    K: Float[Array, ""]


class ExternalPotential(AbstractEnergy):
    r"""$\int \phi(x)\,\mathrm{d}A$: a potential in space acts on every piece of membrane.

    Its normal force is $-(\phi H + \partial_\nu\phi)$.

    **Arguments:**

    - `potential`: $\phi$, a function of one point, energy/length². Derivatives pass the arrays and
      floats that it closes over.

    **Raises:** `ValueError` when called, unless $\phi$ is one number.

    ```python
    gravity = jw.energies.ExternalPotential(lambda p: 0.1 * p[2])
    ```
    """

    potential: Callable[[Float[Array, "3"]], Float[Array, ""]]

    def __init__(self, potential):
        self.potential = as_data(potential)

    def __call__(self, mesh, x, fields=None):
        x = nodes_of(mesh, x)
        return integrate(
            mesh, x, lambda point, _: _one_number("potential", self.potential(point.position))
        )


class Density(AbstractEnergy):
    r"""$\int f\,\mathrm{d}A$ with a density of position, normal, curvatures and nodal fields.

    **Arguments:**

    - `density`: $f$, a function `(point, fields) -> scalar` of a `SurfacePoint` and of the jets of
      the fields: `fields.c.value` and its tangential gradient `fields.c.grad`. Give an `eqx.Module`
      to keep its parameters differentiable.
    - `fields`: nodal arrays by name, of shape `nodes` or `nodes 3`; they stay on their nodes when
      `x` moves. Fields of the moment, `energy(mesh, x, fields)`, join them or replace those of
      the same name.

    **Raises:** `ValueError` when called, for a field that does not have one row for every node or a
    density that is not one number.

    *Limits:* on irregular meshes `K`, and on those of degree 1 `H` too, converges in integrals that
    are linear in it, not pointwise.

    ```python
    fourth = jw.energies.Density(lambda p, f: p.H**4)
    mixing = jw.energies.Density(lambda p, f: 0.5 * jnp.sum(f.c.grad**2), {"c": c})
    energy = jw.energies.Willmore() + 0.1 * fourth + mixing
    ```
    """

    density: Callable[[SurfacePoint, SimpleNamespace], Float[Array, ""]]
    fields: dict[str, Float[Array, "..."]]

    def __init__(self, density, fields=None):
        self.density = as_data(density)
        given = {} if fields is None else fields
        self.fields = {name: jnp.asarray(value, float) for name, value in given.items()}

    def __call__(self, mesh, x, fields=None):
        x = nodes_of(mesh, x)
        now = {} if fields is None else {name: double(name, f) for name, f in fields.items()}
        now = self.fields | now
        for name, field in now.items():
            if field.shape not in ((mesh.n_nodes,), (mesh.n_nodes, 3)):
                raise ValueError(
                    f"The field `{name}` needs shape ({mesh.n_nodes},) or ({mesh.n_nodes}, 3), one "
                    f"row for every node; got {field.shape}."
                )

        def density(here, f):
            H = jnp.sum(f.Y.value * here.normal)
            point = SurfacePoint(here.position, here.normal, H, f.K.value)
            own = {name: getattr(f, f"own_{name}") for name in now}
            return _one_number("density", self.density(point, SimpleNamespace(**own)))

        curvature = {
            "Y": mean_curvature_vector(mesh, x),
            "K": recover_gaussian_curvature(mesh, x),
        }
        # A prefix, so that a field of the user may have any name.
        own = {f"own_{name}": field for name, field in now.items()}
        return integrate(mesh, x, density, curvature | own)


def _one_number(name: str, value) -> Float[Array, ""]:
    if jnp.shape(value) != ():
        raise ValueError(f"`{name}` must return one number; got shape {jnp.shape(value)}.")
    return jnp.asarray(value, float)

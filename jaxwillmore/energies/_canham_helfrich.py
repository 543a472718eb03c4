"""Canham–Helfrich energy; parameters are numbers, live on the nodes, or follow a concentration."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arguments import double
from ..fem import Jet, integrate
from ..mesh import SurfaceMesh
from ..surface import gaussian_curvature_load, mean_curvature_vector
from ._base import AbstractEnergy
from ._mixture import AbstractModulus, finite_modulus, modulus_at, positive_modulus
from ._parameters import density_of, nodes_of, on_nodes

PARAMETERS = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")


class CanhamHelfrich(AbstractEnergy):
    r"""$E = \int b_b (H - H_0)^2 + b_k K$ from the weak mean curvature vector of the nodes.

    With $Y \approx H\nu$: $\int b_b (|Y|^2 - 2 H_0\,Y\cdot n_\Gamma + H_0^2)$. Every parameter is a
    number, a field with one number for every node, or a function of the concentration `fields["c"]`
    (a `Mixture`), which is evaluated at the quadrature points. $\int b_k K$ comes from
    `surface.gaussian_curvature_load`: a constant $b_k$ adds the constant $2\pi\chi\,b_k$
    (Gauss–Bonnet), and a field acts by its gradient alone.

    A field of the moment with the name of a parameter, `energy(mesh, x, fields)`, replaces it: a
    flow carries parameters along.

    **Arguments:**

    - `bending_modulus`: $b_b$, energy; $\kappa/2$ in the physicists' convention, see `from_kappa`.
    - `gaussian_modulus`: $b_k$, energy.
    - `spontaneous_curvature`: $H_0$, 1/length, for the sum of the principal curvatures.

    **Raises:** `ValueError` for a parameter that is not finite, a bending modulus that is not
    positive (in every phase), and, when called, for a field that does not have one number for every
    node, or without the concentration where a parameter depends on it.

    ```python
    soft = jnp.where(x[:, 2] > 0, 0.2, 0.5)
    energy = jw.energies.CanhamHelfrich(soft, spontaneous_curvature=1.0)
    value = energy(mesh, x)
    ```
    """

    # Numbers, one for every node, or functions of c, each on its own.
    bending_modulus: Any
    gaussian_modulus: Any
    spontaneous_curvature: Any

    def __init__(
        self,
        bending_modulus: Any = 0.5,
        gaussian_modulus: Any = 0.0,
        spontaneous_curvature: Any = 0.0,
    ):
        self.bending_modulus = positive_modulus("bending_modulus", bending_modulus)
        self.gaussian_modulus = finite_modulus("gaussian_modulus", gaussian_modulus)
        self.spontaneous_curvature = finite_modulus("spontaneous_curvature", spontaneous_curvature)

    @classmethod
    def from_kappa(
        cls, kappa, gaussian_modulus: Any = 0.0, spontaneous_curvature: Any = 0.0
    ) -> "CanhamHelfrich":
        r"""$\int \tfrac\kappa2 (H - H_0)^2 + \bar\kappa K$ as physicists write it: $b_b=\kappa/2$.

        $H = \kappa_1 + \kappa_2$ as everywhere; for the mean $\bar H = H/2$ with $\bar H_0$ give
        `spontaneous_curvature` $= 2\bar H_0$.
        """
        return cls(0.5 * positive_modulus("kappa", kappa), gaussian_modulus, spontaneous_curvature)

    def __call__(self, mesh, x, fields=None):
        parts = self.parts(mesh, nodes_of(mesh, x), fields)
        return sum(parts.values(), start=jnp.zeros(()))

    def parts(
        self,
        mesh: SurfaceMesh,
        x: Float[Array, "nodes 3"],
        fields: Mapping[str, Array] | None = None,
    ) -> dict[str, Float[Array, ""]]:
        r"""$\int b_b (H - H_0)^2$ as `bending`, $\int b_k K$ as `gaussian`."""
        x, now = nodes_of(mesh, x), self._now(mesh, fields)
        b_k, chi = now["gaussian_modulus"], mesh.euler_characteristic
        if _is_number(b_k):
            gaussian = 2 * jnp.pi * chi * b_k
        else:
            gaussian = jnp.vdot(_on_nodes(mesh, b_k, now), gaussian_curvature_load(mesh, x))
        return {"bending": _bending(mesh, x, now, 1.0), "gaussian": gaussian}

    def scale(self, mesh, x, fields=None):
        r"""$\int b_b (|Y|^2 + H_0^2) + |\int (b_k - \bar b_k) K|$: what the energy is made of.

        Where $H \approx H_0$ the energy vanishes while its terms do not, and the errors of the
        discretisation are relative to them. The mean $\bar b_k$ adds nothing but a constant.
        """
        x, now = nodes_of(mesh, x), self._now(mesh, fields)
        bending, b_k = _bending(mesh, x, now, 0.0), now["gaussian_modulus"]
        if _is_number(b_k):
            return bending
        b_k = _on_nodes(mesh, b_k, now)
        load = gaussian_curvature_load(mesh, x)
        return bending + jnp.abs(jnp.vdot(b_k - jnp.mean(b_k), load))

    def density(
        self,
        c: Jet,
        H: Float[Array, ""],
        K: Float[Array, ""],
        nodal: Mapping[str, Jet] | None = None,
    ) -> Float[Array, ""]:
        r"""$b_b(c)(H - H_0(c))^2 + b_k(c) K$ at one point, energy/length².

        **Arguments:**

        - `nodal`: jets of the parameters that are fields with one number for every node, by name.
        """
        own = {name: getattr(self, name) for name in PARAMETERS}
        b_b, H0, b_k = (
            modulus_at(p, c.value) for p in (own | ({} if nodal is None else dict(nodal))).values()
        )
        return b_b * (H - H0) ** 2 + b_k * K

    def _now(self, mesh, fields) -> dict[str, Any]:
        """The parameters of the moment by name, and the concentration if one depends on it."""
        given = {} if fields is None else fields
        now: dict[str, Any] = {}
        for name in PARAMETERS:
            value = double(name, given[name]) if name in given else getattr(self, name)
            if not isinstance(value, AbstractModulus):
                on_nodes(name, value, mesh)
            now[name] = value
        if any(isinstance(value, AbstractModulus) for value in now.values()):
            now["c"] = density_of(mesh, fields, "An energy with moduli that depend on c")
        return now


def weak_bending(
    b_b: Float[Array, ""],
    H0: Float[Array, ""],
    Y: Float[Array, "3"],
    normal: Float[Array, "3"],
    mixed: float = 1.0,
) -> Float[Array, ""]:
    r"""$b_b (|Y|^2 - 2 m H_0\,Y\cdot n_\Gamma + H_0^2)$ at one point, m for `mixed`.

    $b_b (H - H_0)^2$ for m = 1; the sizes of its terms for m = 0.
    """
    return b_b * (jnp.sum(Y**2) - 2 * mixed * H0 * jnp.sum(Y * normal) + H0**2)


def _bending(mesh, x, now: dict[str, Any], mixed: float) -> Float[Array, ""]:
    r"""$\int$ of `weak_bending` with the parameters of the moment."""
    moduli = {name: now[name] for name in ("bending_modulus", "spontaneous_curvature")}
    nodal = {
        name: on_nodes(name, p, mesh)
        for name, p in moduli.items()
        if not isinstance(p, AbstractModulus)
    }
    nodal |= {"c": now["c"]} if "c" in now else {}

    def density(point, f):
        b_b, H0 = (
            p(f.c.value) if isinstance(p, AbstractModulus) else getattr(f, name).value
            for name, p in moduli.items()
        )
        return weak_bending(b_b, H0, f.Y.value, point.normal, mixed)

    return integrate(mesh, x, density, {"Y": mean_curvature_vector(mesh, x), **nodal})


def _is_number(parameter: Any) -> bool:
    return not isinstance(parameter, AbstractModulus) and parameter.ndim == 0


def _on_nodes(mesh, b_k: Any, now) -> Float[Array, " nodes"]:
    if isinstance(b_k, AbstractModulus):
        return b_k(now["c"])
    return on_nodes("gaussian_modulus", b_k, mesh)

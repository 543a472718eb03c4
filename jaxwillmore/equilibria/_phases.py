r"""The two-phase energy without dimension, and its Gaussian part as a function of the nodes."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import AbstractModulus, TwoPhase, modulus_at
from ..fem import Jet, gather
from ..mesh import SurfaceMesh
from ..surface import gaussian_curvature_load


class ScaledPhases(eqx.Module):
    r"""A two-phase energy as a function of dimensionless numbers.

    **Attributes:**

    - `energy`: in the units of the user.
    - `length`, `kappa`: the units of length and energy.
    """

    energy: TwoPhase
    length: Float[Array, ""]
    kappa: Float[Array, ""]

    def kappa_at(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$2 b_b(c)$."""
        return 2 * modulus_at(self.energy.bending.bending_modulus, c) / self.kappa

    def curvature_at(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$H_0(c)$."""
        return modulus_at(self.energy.bending.spontaneous_curvature, c) * self.length

    def mixing(self, c: Jet) -> Float[Array, ""]:
        r"""$\Psi(c) + \tfrac\gamma2|\nabla c|^2$ at one point."""
        there = Jet(c.value, c.grad / self.length)
        return self.energy.mixing.density(there) * self.length**2 / self.kappa

    @property
    def is_gaussian(self) -> bool:
        """Whether $b_k$ depends on c; a constant one only adds a constant."""
        return isinstance(self._gaussian_modulus, AbstractModulus)

    @property
    def _gaussian_modulus(self) -> Any:
        return self.energy.bending.gaussian_modulus

    def gaussian_modulus_at(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        """$b_k(c)$."""
        return modulus_at(self._gaussian_modulus, c) / self.kappa

    def gaussian(self, mesh: SurfaceMesh, x, c) -> Float[Array, ""]:
        r"""$\int b_k(c)\,\mathrm dK$ with $b_k$ at the nodes."""
        if not self.is_gaussian:
            return 2 * jnp.pi * mesh.euler_characteristic * self.gaussian_modulus_at(jnp.zeros(()))
        return jnp.vdot(self.gaussian_modulus_at(c), gaussian_curvature_load(mesh, x))


@eqx.filter_jit
def gaussian_second_derivatives(phases: ScaledPhases, mesh: SurfaceMesh, x, n, c):
    r"""Second derivatives of `ScaledPhases.gaussian` by $(s, c)$, nodes moving along `n`.

    The load of a node is a sum over its cells, each of which depends on its own nodes alone. On the
    mesh torn apart into its cells all of them are differentiated by the same local node at once.

    **Returns:** of every cell the derivatives by s twice and by c and s, and of every node that by
    c twice.
    """
    T, m = mesh.cells.shape
    # Nothing but the cells is looked at: a torn mesh is no closed surface. (2π at the vertices is
    # a constant.)
    torn = SurfaceMesh(jnp.arange(T * m, dtype=jnp.int32).reshape(T, m), mesh.degree, T * m)
    X, N, C = (gather(mesh, field).reshape(T * m, -1) for field in (x, n, c[:, None]))

    def by_s(s):
        def energy(s):
            return phases.gaussian(torn, X + s[:, None] * N, C[:, 0])

        return jax.grad(energy)(s)

    def loads(s):
        return gaussian_curvature_load(torn, X + s[:, None] * N)

    slope = jax.vmap(jax.grad(phases.gaussian_modulus_at))
    bend = jax.vmap(jax.grad(jax.grad(phases.gaussian_modulus_at)))

    def column(local):
        unit = jnp.broadcast_to(local[None], (T, m)).reshape(-1)
        zero = jnp.zeros(T * m)
        s_s = jax.jvp(by_s, (zero,), (unit,))[1]
        c_s = slope(C[:, 0]) * jax.jvp(loads, (zero,), (unit,))[1]
        return s_s.reshape(T, m), c_s.reshape(T, m)

    s_s, c_s = jax.lax.map(column, jnp.eye(m))
    c_c = bend(c) * gaussian_curvature_load(mesh, x)
    return jnp.moveaxis(s_s, 0, -1), jnp.moveaxis(c_s, 0, -1), c_c

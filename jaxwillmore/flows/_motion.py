"""Forces and motions that come from outside, and the drift that a discretisation makes."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._functions import as_data
from ..fem import inner, integrate
from ._law import AbstractLaw, Globals, Local, Statement, Units, Whole


class Forcing(AbstractLaw):
    r"""A normal velocity $f(t, x)$ added to the law of the surface.

    For manufactured solutions and external fields. It is evaluated at the nodes extrapolated to
    the new time. It does work, so that steps are not rejected for a rise of the energy.

    **Arguments:**

    - `forcing`: $f$, a function `(t, x) -> scalar` of time and one point, length/time.
    """

    forcing: Callable[[Float[Array, ""], Float[Array, "3"]], Float[Array, ""]]

    def __init__(self, forcing):
        self.forcing = as_data(forcing)

    def statement(self):
        return Statement(
            reads=("V",),
            force=lambda s: s.data.forcing.value,
            data={"forcing": lambda s: jax.vmap(lambda p: self.forcing(s.t, p))(s.x)},
            lowers_energy=False,
        )


class GivenMotion(AbstractLaw):
    r"""A surface on a given path: its nodes are at $X(p, t)$, whatever lives on them.

    Material points move with the nodes: a density obeys $\partial^\bullet c = -c\,\nabla\cdot v +
    \dots$ with $v = \partial_t X$.

    **Arguments:**

    - `path`: $X$, a function `(t, points) -> nodes` of time and the array `points`.
    - `points`: labels of the nodes, one row each; usually the nodes at the start.

    ```python
    growing = jw.flows.GivenMotion(lambda t, p: (1 + t / 2) * p, x)
    mixing = jw.flows.Mixing(jw.energies.GinzburgLandau(line_tension=1.0, interface_width=0.2))
    flow = jw.flows.System(mixing, jw.flows.CahnHilliard(), growing)
    ```
    """

    path: Callable[[Float[Array, ""], Float[Array, "nodes 3"]], Float[Array, "nodes 3"]]
    points: Float[Array, "nodes 3"]

    def __init__(self, path, points):
        self.path, self.points = as_data(path), jnp.asarray(points, float)

    def statement(self):
        return Statement(position=lambda t: self.path(t, self.points), lowers_energy=False)


class NoDrift(AbstractLaw):
    r"""A uniform force $f$ that holds the translation: $\int V\nu = 0$ in every step.

    The forces of an exact surface add up to nothing; those of a mesh do not, and a vesicle of
    unequal phases then settles into a steady translation (1.5e-2 of the velocity scale on 642
    nodes) and is never at rest. The three numbers of $f$ are unknowns; they fall with the mesh.
    """

    def statement(self):
        names = ("drift_x", "drift_y", "drift_z")
        return Statement(
            reads=("V", "nu"),
            force=lambda s: inner(self._vector(s), s.hat.nu.value),
            globals=Globals(names, self._closures, self._scales),
        )

    def _vector(self, s: Local):
        m = s.multipliers
        return jnp.stack([m.drift_x, m.drift_y, m.drift_z])

    def _closures(self, s: Whole):
        fields = {"V": s.fields["V"], "nu": s.fields["nu"]}
        total = integrate(s.mesh, s.x, lambda _, f: f.V.value * f.nu.value, fields)
        return total / jax.lax.stop_gradient(s.units.velocity * s.units.length**2)

    def _scales(self, u: Units):
        return jnp.broadcast_to(u.velocity, (3,))

r"""The scheme of Barrett, Garcke and Nürnberg for mean curvature flow."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet, Layout, Point, inner
from ._base import AbstractScheme
from ._lumped import lumped_mean_curvature, vertex_rule


def normal_motion(x: Jet, point: Point, chi: Jet) -> Float[Array, ""]:
    r"""$((x^{n+1} - x^n)\cdot\nu^n, \chi)^h$: tangential motion is free."""
    return inner(x.value - point.position, point.normal) * chi.value


def curvature_equation(x: Jet, H: Jet, point: Point, eta: Jet) -> Float[Array, ""]:
    r"""$(H\nu^n, \eta)^h - (\nabla x^{n+1}, \nabla\eta) = 0$, with vector test functions.

    Three equations per vertex for one curvature: the other two place the vertices.
    """
    return H.value * inner(point.normal, eta.value) - inner(x.grad, eta.grad)


class BGNMeanCurvature(AbstractScheme):
    r"""Mean curvature flow $V = -H$ with the normal velocity alone prescribed.

    $$ \frac1\tau((x^{n+1} - x^n)\cdot\nu^n, \chi)^h + (H^{n+1}, \chi)^h = 0, \qquad
       (H^{n+1}\nu^n, \eta)^h - (\nabla x^{n+1}, \nabla\eta) = 0 $$

    for all scalar $\chi$ and vector $\eta$, with lumped masses and the normals of the triangles.
    The second equation is more than a definition of H: its tangential part makes the surface
    conformal, which keeps the triangles from degenerating. Degree 1.

    ??? cite "Reference"
        Barrett, Garcke, Nürnberg (2008), *J. Comput. Phys.* 227, 4281–4307 (with $\kappa = -H$).
    """

    layout: ClassVar[Layout] = Layout(("x", "H"), (3, 1))
    data: ClassVar[Layout] = Layout((), ())

    def rule(self, mesh):
        return vertex_rule(mesh)

    def equation(self, name, point, trial, data, tau, chi):
        if name == "x":
            return curvature_equation(trial.x, trial.H, point, chi)
        return normal_motion(trial.x, point, chi) / tau + trial.H.value * chi.value

    def nodal_data(self, mesh, x, fields):
        return {}

    def initial_fields(self, mesh, x):
        return {"H": lumped_mean_curvature(mesh, x)}

    def scales(self, length):
        return jnp.concatenate([length * jnp.ones(3), jnp.ones(1) / length])

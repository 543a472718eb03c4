r"""Dziuk's scheme for mean curvature flow."""

from typing import ClassVar

import jax.numpy as jnp

from ..fem import Layout, inner, rule_for
from ._base import AbstractScheme


class DziukMeanCurvature(AbstractScheme):
    r"""Mean curvature flow $V = -H$ by the heat equation of the surface on itself.

    From $\dot x = -H\nu = \Delta_{\Gamma} x$, with the old surface under all integrals,

    $$ \frac1\tau (x^{n+1} - x^n, \chi) + (\nabla_{\Gamma^n} x^{n+1}, \nabla_{\Gamma^n}\chi) = 0 $$

    for all $\chi \in S_h(\Gamma^n)^3$, with the consistent mass matrix. The area never rises. Nodes
    move along the mean curvature vector of the mesh, so that triangles are not kept from
    degenerating. Any degree.

    ??? cite "Reference"
        Dziuk (1990), *Numer. Math.* 58, 603–611.
    """

    layout: ClassVar[Layout] = Layout(("x",), (3,))
    data: ClassVar[Layout] = Layout((), ())

    def rule(self, mesh):
        return rule_for(mesh)

    def equation(self, name, point, trial, data, tau, chi):
        move = trial.x.value - point.position
        return inner(move, chi.value) / tau + inner(trial.x.grad, chi.grad)

    def nodal_data(self, mesh, x, fields):
        return {}

    def initial_fields(self, mesh, x):
        return {}

    def scales(self, length):
        return length * jnp.ones(3)

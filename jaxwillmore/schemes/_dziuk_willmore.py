r"""Dziuk's mixed scheme for Willmore flow."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import positive
from ..fem import Jet, Layout, Point, inner, rule_for, trace
from ..surface import mean_curvature_vector
from ._base import AbstractScheme


def divergence_variation(Y: Jet, point: Point, phi: Jet) -> Float[Array, ""]:
    r"""First variation of $\int_\Gamma \nabla_\Gamma\cdot Y$ at fixed nodal values of Y:

    $$ (\nabla Y, \nabla\varphi) + (\nabla\cdot Y, \nabla\cdot\varphi)
       - (\nabla Y, P\,(\nabla\varphi + \nabla\varphi^T)) $$

    with gradients as rows and $P = I - nn^T$: what the paper writes with
    $D(\varphi) = \nabla\varphi + \nabla\varphi^T$.
    """
    W, Phi = Y.grad, phi.grad
    P = jnp.eye(3) - jnp.outer(point.normal, point.normal)
    return inner(W, Phi) + trace(W) * trace(Phi) - inner(W, P @ (Phi + Phi.T))


def area_variation(x: Jet, phi: Jet) -> Float[Array, ""]:
    r"""$(\nabla x, \nabla\varphi)$, which is $\nabla\cdot\varphi$ for the surface's own x."""
    return inner(x.grad, phi.grad)


class DziukWillmore(AbstractScheme):
    r"""Willmore flow, the gradient flow of $b_b\int |Y|^2$ with $Y = -\Delta_\Gamma x = H\nu$.

    The energy is $2 b_b \max_Y \int \nabla\cdot Y - \tfrac12|Y|^2$, so that its first variation
    holds Y fixed. Linear in the new x and Y on the old surface:

    $$ \frac1\tau(x^{n+1} - x^n, \varphi) + 2b_b\big[
       (\nabla Y^{n+1}, \nabla\varphi) + (\nabla\cdot Y^n, \nabla\cdot\varphi)
       - (\nabla Y^n, P D(\varphi))
       - \tfrac12(|Y^n|^2\,\nabla x^{n+1}, \nabla\varphi)\big] = 0, $$
    $$ (Y^{n+1}, \psi) - (\nabla x^{n+1}, \nabla\psi) = 0 $$

    for all $\varphi, \psi \in S_h(\Gamma^n)^3$. At rest this is the exact gradient of the discrete
    energy, tangential part included: nodes also move where the mesh makes the energy lower. The
    divergence and the term with $D(\varphi)$ are taken old: with $Y^{n+1}$ in them, steps of 1e-3
    on 162 and of 1e-4 on 642 vertices of an ellipsoid of unit size blew up; as it is, 1e-3 works
    on both. Any degree; the paper takes degree 1.

    **Arguments:**

    - `bending_modulus`: $b_b$; Willmore flow is 1/2.

    **Raises:** `ValueError` for a modulus that is not positive.

    ??? cite "Reference"
        Dziuk (2008), *Numer. Math.* 111, 55–80 (with $-Y$ for our Y). The first variation is the
        paper's; which of its terms are old and which new was decided here, as said above.
    """

    bending_modulus: Float[Array, ""]

    layout: ClassVar[Layout] = Layout(("x", "Y"), (3, 3))
    data: ClassVar[Layout] = Layout(("Y_old",), (3,))

    def __init__(self, bending_modulus=0.5):
        self.bending_modulus = positive("bending_modulus", bending_modulus)

    def rule(self, mesh):
        return rule_for(mesh)

    def equation(self, name, point, trial, data, tau, chi):
        x, Y, Y_old = trial.x, trial.Y, data.Y_old
        if name == "Y":
            return inner(Y.value, chi.value) - inner(x.grad, chi.grad)
        variation = (
            divergence_variation(Y_old, point, chi)
            + inner(Y.grad - Y_old.grad, chi.grad)
            - 0.5 * inner(Y_old.value, Y_old.value) * area_variation(x, chi)
        )
        move = x.value - point.position
        return inner(move, chi.value) / tau + 2 * self.bending_modulus * variation

    def nodal_data(self, mesh, x, fields):
        return {"Y_old": fields["Y"]}

    def initial_fields(self, mesh, x):
        return {"Y": mean_curvature_vector(mesh, x)}

    def scales(self, length):
        return jnp.concatenate([length * jnp.ones(3), jnp.ones(3) / length])

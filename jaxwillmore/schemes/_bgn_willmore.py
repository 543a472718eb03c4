r"""A scheme of Barrett, Garcke and Nürnberg for Willmore flow."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..energies import positive
from ..fem import Layout, inner
from ._base import AbstractScheme
from ._bgn_mean_curvature import curvature_equation, normal_motion
from ._lumped import lumped_mean_curvature, lumped_weingarten_squared, vertex_rule


class BGNWillmore(AbstractScheme):
    r"""Willmore flow $V = 2b_b(\Delta_\Gamma H + |A|^2 H - \tfrac12 H^3)$, tangential motion free.

    $$ \frac1\tau((x^{n+1} - x^n)\cdot\nu^n, \chi)^h + 2b_b\big[(\nabla H^{n+1}, \nabla\chi)
       + \tfrac12((H^n)^2 H^{n+1}, \chi)^h - (|A^n|^2 H^n, \chi)^h\big] = 0, $$
    $$ (H^{n+1}\nu^n, \eta)^h - (\nabla x^{n+1}, \nabla\eta) = 0 $$

    for all scalar $\chi$ and vector $\eta$, with lumped masses, the normals of the triangles and
    the lumped weak Weingarten map $A^n$ (`lumped_weingarten_squared`). The sign of the cubic term
    decides what is taken new: so every step has exactly one solution, whatever its size, provided
    that the vertex normals span the space. Degree 1. The energy is not bound to fall.

    **Arguments:**

    - `bending_modulus`: $b_b$; Willmore flow is 1/2.

    **Raises:** `ValueError` for a modulus that is not positive.

    ??? cite "Reference"
        Barrett, Garcke, Nürnberg (2008), *SIAM J. Sci. Comput.* 31, 225–253 (with $\kappa = -H$).
        The equations above were derived from the law in the manner of that paper; the treatment of
        $|A|^2$ and of the old and new H need not be the paper's in every detail.
    """

    bending_modulus: Float[Array, ""]

    layout: ClassVar[Layout] = Layout(("x", "H"), (3, 1))
    data: ClassVar[Layout] = Layout(("H_old", "A_squared"), (1, 1))

    def __init__(self, bending_modulus=0.5):
        self.bending_modulus = positive("bending_modulus", bending_modulus)

    def rule(self, mesh):
        return vertex_rule(mesh)

    def equation(self, name, point, trial, data, tau, chi):
        x, H, H_old = trial.x, trial.H, data.H_old.value
        if name == "x":
            return curvature_equation(x, H, point, chi)
        cubic = 0.5 * H_old**2 * H.value - data.A_squared.value * H_old
        law = inner(H.grad, chi.grad) + cubic * chi.value
        return normal_motion(x, point, chi) / tau + 2 * self.bending_modulus * law

    def nodal_data(self, mesh, x, fields):
        H = fields["H"]
        return {"H_old": H, "A_squared": lumped_weingarten_squared(mesh, x, H)}

    def initial_fields(self, mesh, x):
        return {"H": lumped_mean_curvature(mesh, x)}

    def scales(self, length):
        return jnp.concatenate([length * jnp.ones(3), jnp.ones(1) / length])

"""Both first variations of the two-phase energy against the formulas by hand, and by Taylor tests.

−V_c by the surface, with the concentration on its nodes, and μ by the concentration.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import Mixture, QuarticWell, TwoPhase
from jaxwillmore.fem import integrate
from jaxwillmore.mesh import ellipsoid
from jaxwillmore.surface import Ellipsoid

from ..helpers import observed_order
from .variations import Exact

AXES = (1.0, 1.2, 1.5)
EXACT = Exact(Ellipsoid(AXES))
WELL = QuarticWell(0.3, 0.6)
B_B, H0 = Mixture(0.5, 0.8), Mixture(-0.2, 0.9)


def b_k(c):
    return 0.4 * jnp.sin(2 * c) - 0.3 * c


def c(p):
    return 0.5 + 0.3 * jnp.sin(1.2 * p[0] + 0.7 * p[1]) - 0.2 * p[2] * p[1]


def speed(p):
    return 1.0 + 0.5 * p[0] - 0.3 * p[1] * p[2] + p[2] ** 2


def change(p):
    return jnp.cos(p[0]) - 0.4 * p[1] + 0.6 * p[2] * p[0]


ENERGY = TwoPhase(B_B, H0, b_k, well=WELL)
PARTS = ("bending", "gaussian", "phase")


def parts(mesh, x, c):
    return jnp.stack([ENERGY.parts(mesh, x, {"c": c})[name] for name in PARTS])


@eqx.filter_jit
def slopes(mesh, x):
    """dE by the surface and by the concentration, in fixed directions."""
    nodal = jax.vmap(c)(x)
    normal = jax.vmap(lambda p: speed(p) * EXACT.normal(p))(x)
    _, by_surface = jax.jvp(lambda x: jnp.sum(parts(mesh, x, nodal)), (x,), (normal,))
    psi = jax.vmap(change)(x)
    _, by_field = jax.jvp(lambda c: jnp.sum(parts(mesh, x, c)), (nodal,), (psi,))
    return jnp.stack([by_surface, by_field])


@eqx.filter_jit
def exact_slopes(mesh, x):
    """−∫ V_c φ and ∫ μ ψ, and the integrals of their absolute values."""
    laws = (c, B_B, H0, b_k, WELL.potential, WELL.gradient_coefficient)
    force, potential = EXACT.two_phase_force(*laws), EXACT.chemical_potential(*laws)
    at = jax.vmap(lambda p: jnp.stack([-force(p) * speed(p), potential(p) * change(p)]))(x)
    density = lambda _, f: jnp.stack([f.at.value, jnp.abs(f.at.value)])
    return integrate(mesh, x, density, {"at": at})


@pytest.fixture(scope="module")
def reference():
    """On a mesh whose error (order 4) does not show."""
    return exact_slopes(*ellipsoid(AXES, 3, 2))


@pytest.fixture(scope="module")
def errors(reference):
    exact, size = reference
    found = [slopes(*ellipsoid(AXES, level, 2)) for level in (1, 2)]
    return [np.asarray(jnp.abs(slope - exact) / size) for slope in found]


@pytest.mark.parametrize("k, name", [(0, "surface"), (1, "concentration")])
def test_the_first_variation_is_the_formula(errors, k, name):
    """On 162 and 642 nodes 2e-3 and 1.4e-4 of ∫|V_c φ| and ∫|μψ|: order 4, as the nodes."""
    coarse, fine = (error[k] for error in errors)
    assert coarse < 3e-3, coarse
    assert np.log2(coarse / fine) > 3.5, (coarse, fine)


@pytest.mark.parametrize("by", ["surface", "concentration", "parameters"])
def test_the_taylor_remainder_is_quadratic(by):
    mesh, x = ellipsoid(AXES, 0, 2)
    key = jr.key(3)
    flat, unravel = {
        "surface": (x.reshape(-1), lambda v: (ENERGY, v.reshape(x.shape), jax.vmap(c)(x))),
        "concentration": (jax.vmap(c)(x), lambda v: (ENERGY, x, v)),
        "parameters": (
            jnp.array([0.5, 0.8, -0.2, 0.9, 0.3, 0.6]),
            lambda v: (
                TwoPhase(Mixture(*v[:2]), Mixture(*v[2:4]), b_k, v[4], v[5]),
                x,
                jax.vmap(c)(x),
            ),
        ),
    }[by]

    @jax.jit
    def f(v):
        energy, nodes, c = unravel(v)
        return energy(mesh, nodes, {"c": c})

    direction, steps = jr.normal(key, flat.shape), (4e-4, 2e-4, 1e-4)
    value, slope = jax.jit(lambda v: jax.jvp(f, (v,), (direction,)))(flat)
    remainders = [abs(f(flat + h * direction) - value - h * slope) for h in steps]
    order = observed_order(steps, np.stack(remainders))
    assert abs(order - 2) < 0.05, (order, remainders)
    gradient = jax.jit(jax.grad(f))(flat)
    np.testing.assert_allclose(jnp.vdot(gradient, direction), slope, rtol=1e-10)

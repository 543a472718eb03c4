"""Every energy: its derivative by a Taylor test, its first variation against the exact formula."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxwillmore import energies as je
from jaxwillmore.fem import integrate
from jaxwillmore.mesh import ellipsoid
from jaxwillmore.surface import Ellipsoid

from ..helpers import observed_order
from .variations import Exact

AXES = (1.0, 1.2, 1.5)
EXACT = Exact(Ellipsoid(AXES))


# Fields in space without symmetry; their values at the nodes are the nodal fields.
def b_b(p):
    return 0.6 + 0.2 * jnp.sin(p[0] + 0.5 * p[1]) + 0.1 * p[2]


def H0(p):
    return 0.4 + 0.3 * p[2] * p[0] + 0.2 * p[1]


def b_k(p):
    return jnp.exp(0.5 * p[0]) * (1 + p[1] * p[2]) + 0.3 * p[2] ** 3


def c(p):
    return jnp.cos(p[1]) + p[0] * p[2]


def potential(p):
    return 0.3 + p[2] ** 2 - 0.5 * p[0] * p[1]


def slanted(p, nu):
    return (1 + 0.5 * p[0]) * nu[2] ** 2 + nu[0] * nu[1]


def bending(b_b, H0):
    return EXACT.of_curvature(
        lambda p: b_b(p) * (EXACT.H(p) - H0(p)) ** 2,
        lambda p: 2 * b_b(p) * (EXACT.H(p) - H0(p)),
    )


def constant(value):
    return lambda p: jnp.asarray(value) + 0.0 * p[0]


class Combined(je.AbstractGlobalEnergy):
    """All global energies at once: their slopes by area, volume and ∫H are tested one by one."""

    parts: je.AbstractEnergy

    def of(self, A, V_p, M):
        total = jnp.zeros(())
        for factor, part in je.terms_of(self.parts):
            assert isinstance(part, je.AbstractGlobalEnergy)
            total += factor * part.of(A, V_p, M)
        return total


GLOBAL = Combined(
    je.SurfaceTension(0.3)
    + 2.0 * je.Pressure(0.2)
    + je.OsmoticPressure(6.0, 1.0, 1.0, 0.5)
    + je.AreaPenalty(0.7, 15.0)
    + je.VolumePenalty(0.4, 6.0)
    + 0.01 * je.AreaDifference(0.5, 0.2, 0.1)
)


def all_energies(x):
    """Energies on the nodes `x` by name."""
    nodal = {f.__name__: jax.vmap(f)(x) for f in (b_b, H0, b_k, c)}
    return {
        "Willmore": je.Willmore(),
        "bending, numbers": je.CanhamHelfrich(0.7, 0.2, 0.5),
        "bending, fields": je.CanhamHelfrich(nodal["b_b"], nodal["b_k"], nodal["H0"]),
        "potential": je.ExternalPotential(potential),
        "cubic in H": je.Density(lambda p, f: f.c.value * p.H**3, {"c": nodal["c"]}),
        "square of K": je.Density(lambda p, _: p.K**2),
        "normal": je.Density(lambda p, _: slanted(p.position, p.normal)),
        "gradient": je.Density(lambda _, f: 0.5 * jnp.sum(f.c.grad**2), {"c": nodal["c"]}),
        "global": GLOBAL,
    }


def exact_gradients():
    """δE/δν at a point; the global energies follow from those of area, volume and ∫H."""
    fields = bending(b_b, H0)
    gauss = EXACT.of_gaussian_curvature(lambda p: b_k(p) * EXACT.K(p), b_k)
    return {
        "Willmore": bending(constant(0.5), constant(0.0)),
        "bending, numbers": bending(constant(0.7), constant(0.5)),
        "bending, fields": lambda p: fields(p) + gauss(p),
        "potential": EXACT.of_position_and_normal(lambda p, _: potential(p)),
        "cubic in H": EXACT.of_curvature(
            lambda p: c(p) * EXACT.H(p) ** 3, lambda p: 3 * c(p) * EXACT.H(p) ** 2
        ),
        "square of K": EXACT.of_gaussian_curvature(
            lambda p: EXACT.K(p) ** 2, lambda p: 2 * EXACT.K(p)
        ),
        "normal": EXACT.of_position_and_normal(slanted),
        "gradient": EXACT.of_gradient(c),
    }


NAMES = tuple(exact_gradients()) + ("global",)


def values(energies, mesh, x):
    return jnp.stack([energy(mesh, x) for energy in energies.values()])


# 1. The derivative by nodes and parameters together.


@pytest.fixture(scope="module")
def taylor():
    """Remainders of every energy at three steps, and the slopes in both modes."""
    mesh, x = ellipsoid(AXES, 0, 2)
    arrays, rest = eqx.partition((all_energies(x), x), eqx.is_array)
    flat, unravel = ravel_pytree(arrays)

    def f(v):
        energies, nodes = eqx.combine(unravel(v), rest)
        return values(energies, mesh, nodes)

    direction = jr.normal(jr.key(0), flat.shape)
    f, steps = jax.jit(f), (2e-4, 1e-4, 5e-5)
    here, slope = jax.jit(lambda v: jax.jvp(f, (v,), (direction,)))(flat)
    remainders = jnp.stack([jnp.abs(f(flat + h * direction) - here - h * slope) for h in steps])
    weights = jnp.arange(1.0, len(NAMES) + 1)
    gradient = jax.jit(jax.grad(lambda v: jnp.vdot(weights, f(v))))(flat)
    return steps, remainders, jnp.vdot(weights, slope), jnp.vdot(gradient, direction)


@pytest.mark.parametrize("k, name", list(enumerate(NAMES)))
def test_the_taylor_remainder_is_quadratic(taylor, k, name):
    steps, remainders, _, _ = taylor
    order = observed_order(steps, remainders[:, k])
    assert abs(order - 2.0) < 0.1, (name, order)


def test_forward_and_reverse_mode_agree(taylor):
    _, _, forward, reverse = taylor
    np.testing.assert_allclose(forward, reverse, rtol=1e-10)


# 2. The first variation in the direction of a normal velocity V.


def speed(p):
    return 1.0 + 0.5 * p[0] - 0.3 * p[1] * p[2] + p[2] ** 2


@eqx.filter_jit
def slopes(mesh, x):
    """dE(Vν) by automatic differentiation of every energy."""
    phi = jax.vmap(lambda p: speed(p) * EXACT.normal(p))(x)
    energies = all_energies(x)
    return jax.jvp(lambda x: values(energies, mesh, x), (x,), (phi,))[1]


@eqx.filter_jit
def exact_slopes(mesh, x):
    """∫ G V with the exact G, and ∫ |G V| to compare errors with."""

    def at(p):
        local = [G(p) for G in exact_gradients().values()]
        return jnp.stack([*local, EXACT.H(p), jnp.ones(()), 2 * EXACT.K(p)]) * speed(p)

    def density(_, f):
        return jnp.stack([f.GV.value, jnp.abs(f.GV.value)])

    signed, size = integrate(mesh, x, density, {"GV": jax.vmap(at)(x)})
    H = jax.vmap(EXACT.H)(x)
    thirds = jnp.stack([jnp.ones(mesh.n_nodes), jax.vmap(lambda p: p @ EXACT.normal(p))(x) / 3, H])
    A, V_p, M = integrate(mesh, x, lambda _, f: f.q.value, {"q": thirds.T})
    partial = jnp.stack(jax.grad(GLOBAL.of, argnums=(0, 1, 2))(A, V_p, M))
    total = jnp.vdot(partial, signed[-3:])[None]
    return jnp.concatenate([signed[:-3], total]), jnp.concatenate(
        [size[:-3], jnp.vdot(jnp.abs(partial), size[-3:])[None]]
    )


@pytest.fixture(scope="module")
def reference():
    """The exact slopes, integrated on a mesh whose error (order 4) does not show."""
    return exact_slopes(*ellipsoid(AXES, 3, 2))


def errors_on(level, reference):
    exact, size = reference
    return np.asarray(jnp.abs(slopes(*ellipsoid(AXES, level, 2)) - exact) / size)


@pytest.fixture(scope="module")
def coarse(reference):
    return errors_on(1, reference)


@pytest.mark.parametrize("k, name", list(enumerate(NAMES)))
def test_the_first_variation_is_the_formula(coarse, k, name):
    """On 162 nodes: 4e-4 to 5e-3 of ∫|GV|, and 1.3e-2 where the gradient of a field is squared."""
    assert coarse[k] < 0.015, coarse[k]


@pytest.mark.slow
def test_the_first_variation_converges(coarse, reference):
    """Order 4 on degree 2 (3.6 to 4.4 here), and 3.2 where the gradient of a field is squared."""
    fine = errors_on(2, reference)
    orders = dict(zip(NAMES, np.log2(coarse / fine), strict=True))
    assert min(orders.values()) > 3, orders

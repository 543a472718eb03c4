"""Assembly: the residual is the integral of the integrand, and the Jacobian its derivative."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import (
    Form,
    Layout,
    cell_jacobians,
    inner,
    integrate,
    point,
    residual,
    rule_for,
    sym,
    trace,
)
from jaxwillmore.mesh import icosphere

LAYOUT, FROZEN = Layout(("c", "u"), (1, 3)), Layout(("f", "w"), (1, 3))


def integrand(point, trial, frozen, test, args):
    """Nonlinear in both unknowns and in everything that a position can enter through."""
    A = sym(trial.u.grad)
    scalar = (
        jnp.sin(trial.c.value) * trace(A) * test.c.value
        + (args + trial.c.value**2) * inner(trial.c.grad, test.c.grad)
        + point.position[0] ** 2 * frozen.f.value * test.c.value
    )
    vector = (
        inner(A @ trial.u.value, test.u.value) * inner(point.normal, frozen.w.value)
        + inner(trial.u.grad, test.u.grad) * jnp.cos(trial.c.value)
        + inner(test.u.grad.T @ point.normal, trial.c.grad)
        + inner(frozen.w.grad, test.u.grad)
    )
    return scalar + vector


@pytest.fixture(scope="module", params=[pytest.param(1, marks=pytest.mark.slow), 2])
def case(request):
    mesh, x = icosphere(0, request.param)
    keys = jr.split(jr.key(0), 4)
    x = x + 0.05 * jr.normal(keys[0], x.shape)
    U = jr.normal(keys[1], (mesh.n_nodes, LAYOUT.width))
    Z = jr.normal(keys[2], (mesh.n_nodes, FROZEN.width))
    B = jr.normal(keys[3], (3, LAYOUT.width))
    form, args = Form(integrand, LAYOUT, FROZEN), jnp.asarray(0.7)
    return mesh, x, U, Z, B, form, args, rule_for(mesh)


def dense(mesh, local):
    """The global matrix, entry [node, equation, node, unknown]."""
    cells, fields = np.asarray(mesh.cells), local.shape[-1]
    out = np.zeros((mesh.n_nodes, mesh.n_nodes, fields, fields))
    np.add.at(out, (cells[:, :, None], cells[:, None, :]), np.asarray(local))
    return out.transpose(0, 2, 1, 3)


def test_the_residual_is_the_tested_integral(case):
    mesh, x, U, Z, _, form, args, rule = case
    T = jr.normal(jr.key(1), U.shape)
    parts = {}
    for prefix, layout, array in (("", LAYOUT, U), ("", FROZEN, Z), ("test_", LAYOUT, T)):
        parts |= {prefix + name: value for name, value in layout.split(array, axis=1).items()}

    class Test:
        def __init__(self, f):
            self.c, self.u = f.test_c, f.test_u

    @jax.jit
    def whole(parts):
        return integrate(
            mesh,
            x,
            lambda point, f: integrand(point, f, f, Test(f), args),
            parts,
            quadrature_degree=2 * mesh.degree,
        )

    tested = jnp.vdot(T, jax.jit(lambda U: residual(form, mesh, rule, x, U, Z, args))(U))
    np.testing.assert_allclose(tested, whole(parts), rtol=1e-11)


def test_the_jacobian_is_the_dense_one(case):
    """At fixed nodes, and as a total derivative where nodes follow the unknowns, x_j = x_j(U_j)."""
    mesh, x, U, Z, B, form, args, rule = case

    def position(x_j, U_j, moving):
        return x_j + moving * 0.1 * jnp.sin(B @ U_j)

    def positions(U, moving):
        return jax.vmap(lambda x_j, U_j: position(x_j, U_j, moving))(x, U)

    @jax.jit
    def chained(U):
        x_now = positions(U, 1.0)
        dx = jax.vmap(jax.jacfwd(lambda x_j, U_j: position(x_j, U_j, 1.0), argnums=1))(x, U)
        fixed = cell_jacobians(form, mesh, rule, x, U, Z, args)
        return fixed, cell_jacobians(form, mesh, rule, x_now, U, Z, args, dx)

    @jax.jit
    def exact(U, moving):
        def total(U):
            return residual(form, mesh, rule, positions(U, moving), U, Z, args)

        return jax.jacfwd(total)(U)

    for local, moving in zip(chained(U), (0.0, 1.0), strict=True):
        full = exact(U, moving)
        np.testing.assert_allclose(
            dense(mesh, local), full, atol=1e-12 * float(jnp.max(jnp.abs(full)))
        )


def test_the_flux_is_the_coefficient_of_the_test_function():
    """The form is linear in the test jets, so the flux holds all of it."""
    form, args = Form(integrand, LAYOUT, FROZEN), jnp.asarray(0.7)
    keys = jr.split(jr.key(2), 4)
    P, X, Z, T = (
        jr.normal(key, (width, 3))
        for key, width in zip(keys, (LAYOUT.width, 3, FROZEN.width, LAYOUT.width), strict=True)
    )

    @jax.jit
    def both(P, X, Z, T):
        here = point(X[:, 0], X[:, 1:])
        value = here.dA * integrand(
            here, LAYOUT.jets(P, here), FROZEN.jets(Z, here), LAYOUT.jets(T, here), args
        )
        return jnp.vdot(form.flux(P, X, Z, args), T), value

    np.testing.assert_allclose(*both(P, X, Z, T), rtol=1e-12)

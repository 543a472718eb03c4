"""Jacobians at their sparsity: equal to forward mode, entry by entry, without compilation."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from jaxwillmore.fem import (
    EnergyForm,
    Form,
    HostJacobian,
    Layout,
    Unsupported,
    cell_jacobians,
    dependence,
    inner,
    planned_cell_jacobians,
    residual,
    rule_for,
    sym,
    trace,
)
from jaxwillmore.linalg import block_pattern, scatter_blocks
from jaxwillmore.mesh import icosphere

TRIAL, FROZEN = Layout(("H", "V", "nu", "c"), (1, 1, 3, 1)), Layout(("f", "w"), (1, 3))
SCALES = np.array([1.0, 2.0, 0.5, 0.5, 0.5, 3.0]), np.array([1.0, 0.25, 2.0, 2.0, 2.0, 4.0])


class Law(eqx.Module):
    """Moduli, multipliers, a function, and a nodal field that no quadrature point reads."""

    modulus: Float[Array, ""]
    multipliers: Float[Array, " multipliers"]
    function: Callable
    field: Float[Array, " nodes"]


def equations(point, trial, frozen, test, law):
    """Curvature, velocity, normal and a concentration, with the functions a law is made of."""
    A, H, V, c = sym(trial.nu.grad), trial.H.value, trial.V.value, trial.c.value
    Q = law.modulus * (inner(A, A) * H - 0.5 * H**3) + frozen.f.value
    pressure = law.multipliers[0] + law.multipliers[1] * H
    curvature = (H - V) * test.H.value - inner(trial.V.grad, test.H.grad)
    velocity = (V - Q + pressure) * test.V.value + inner(trial.H.grad, test.V.grad)
    normal = (
        inner((H * A - A @ A) @ trial.nu.value, test.nu.value)
        + 2.0 * inner(A @ trial.H.grad, test.nu.grad.T @ trial.nu.value)
        + Q * trace(test.nu.grad)
        + inner(point.normal - trial.nu.value, test.nu.value) * point.position[0]
    )
    share = jnp.where(c > 0, jnp.log(1.0 + jnp.maximum(c, 0.0)), jnp.exp(c) - 1.0)
    mobility = (1.0 + c**2) ** 1.5 + jax.nn.softplus(c)
    conserved = (law.function(c) + share) * test.c.value
    conserved += mobility * inner(trial.c.grad, test.c.grad)
    conserved += inner(frozen.w.value, trial.c.grad) * test.c.value
    return curvature + velocity + normal + conserved


def cubic(c):
    return c**3 - c


FORM = Form(equations, TRIAL, FROZEN)


def law_of(n_nodes, modulus=0.7, function=cubic):
    return Law(jnp.asarray(modulus), jnp.array([0.3, -0.2]), function, jnp.ones(n_nodes))


def velocity(U):
    """Nodes follow v = V nu."""
    return U[1] * U[2:5]


@pytest.fixture(scope="module", params=[1, pytest.param(2, marks=pytest.mark.slow)])
def case(request):
    mesh, x = icosphere(0, request.param)
    rng = np.random.default_rng(0)
    x = np.asarray(x) + 0.05 * rng.normal(size=x.shape)
    U = rng.normal(size=(mesh.n_nodes, TRIAL.width))
    Z = rng.normal(size=(mesh.n_nodes, FROZEN.width))
    dx = np.asarray(jax.vmap(jax.jacfwd(velocity))(U))
    return mesh, x, U, Z, dx, rule_for(mesh), block_pattern(mesh.cells, mesh.n_nodes)


@pytest.fixture(scope="module")
def forward_mode(case):
    mesh, *_, rule, pattern = case

    @eqx.filter_jit
    def blocks(form, x, U, Z, args, dx):
        return scatter_blocks(pattern, cell_jacobians(form, mesh, rule, x, U, Z, args, dx))

    return lambda form, *data: np.asarray(blocks(form, *data))


def made(case, args, form=FORM, moves=None):
    mesh, *_, rule, pattern = case
    blocks = np.asarray(pattern.blocks)
    return HostJacobian(
        form, np.asarray(mesh.cells), rule, blocks, pattern.n_blocks, args, moves=moves
    )


def assert_same(blocks, exact):
    """To rounding, for every pair of fields by itself; the last two axes are fields."""
    size, error = (
        np.max(np.abs(a), axis=tuple(range(a.ndim - 2))) for a in (exact, blocks - exact)
    )
    np.testing.assert_array_equal(error <= 1e-13 * size, True, f"{error}\n{size}")


def test_blocks_are_those_of_forward_mode(case, forward_mode):
    """At fixed nodes, and where nodes follow the unknowns; with scaled rows and columns."""
    mesh, x, U, Z, dx, _, _ = case
    law = law_of(mesh.n_nodes)
    scale = SCALES[0][:, None] * SCALES[1]
    fixed = made(case, law)(x, U, Z, law, None, *SCALES)
    assert_same(fixed, forward_mode(FORM, x, U, Z, law, None) * scale)
    moves = dependence(velocity, TRIAL.width)
    moving = made(case, law, moves=moves)(x, U, Z, law, dx, *SCALES)
    assert_same(moving, forward_mode(FORM, x, U, Z, law, dx) * scale)


def test_batches_of_cells_add_up(case, monkeypatch):
    mesh, x, U, Z, dx, _, _ = case
    law, moves = law_of(mesh.n_nodes), np.ones((3, TRIAL.width), bool)
    whole = made(case, law, moves=moves)
    monkeypatch.setattr("jaxwillmore.fem._host_jacobian.CELLS_AT_ONCE", 7)
    parts = made(case, law, moves=moves)
    assert_same(parts(x, U, Z, law, dx), whole(x, U, Z, law, dx))
    np.testing.assert_allclose(
        parts.residual(x, U, Z, law), whole.residual(x, U, Z, law), atol=1e-13
    )


def test_the_residual_is_that_of_the_form(case):
    mesh, x, U, Z, _, rule, _ = case
    law = law_of(mesh.n_nodes)
    exact = eqx.filter_jit(residual)(FORM, mesh, rule, x, U, Z, law)
    np.testing.assert_allclose(
        made(case, law).residual(x, U, Z, law), exact, atol=1e-13 * np.max(np.abs(exact))
    )


def test_compiled_cell_matrices_are_those_of_forward_mode(case):
    """Also for several surfaces at once, and where nodes follow the unknowns."""
    mesh, x, U, Z, dx, rule, _ = case
    law, U, Z = law_of(mesh.n_nodes), jnp.asarray(U), jnp.asarray(Z)

    def several(function):
        return jax.jit(
            jax.vmap(lambda x, dx: function(FORM, mesh, rule, x, U, Z, law, dx))
        )(np.stack([x, 2 * x]), np.stack([dx, 0 * dx]))  # fmt: skip

    found, exact = (np.asarray(several(f)) for f in (planned_cell_jacobians, cell_jacobians))
    assert_same(found[0], exact[0])
    assert_same(found[1], exact[1])
    fixed = jax.jit(lambda x: planned_cell_jacobians(FORM, mesh, rule, x, U, Z, law))(2 * x)
    assert_same(np.asarray(fixed), exact[1])


def test_compiled_cell_matrices_have_derivatives(case):
    """In reverse mode, by the unknowns and by a modulus."""
    mesh, x, U, Z, _, rule, _ = case
    x, U, Z = map(jnp.asarray, (x, U, Z))

    def slopes(function):
        def total(U, modulus):
            law = eqx.tree_at(lambda law: law.modulus, law_of(mesh.n_nodes), modulus)
            return jnp.sum(jnp.sin(function(FORM, mesh, rule, x, U, Z, law)))

        return jax.jit(jax.grad(total, argnums=(0, 1)))(U, jnp.asarray(0.7))

    for found, exact in zip(slopes(planned_cell_jacobians), slopes(cell_jacobians), strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-11 * np.max(np.abs(exact)))


def test_pairs_that_are_structurally_zero_are_absent(case):
    """The concentration is alone here; moving nodes bring V and nu into every equation."""
    mesh, x, U, Z, dx, _, _ = case
    law = law_of(mesh.n_nodes)
    fixed = made(case, law)
    expected = np.ones((6, 6), bool)
    expected[5, :5] = expected[:5, 5] = False
    expected[0, 2:5] = expected[2:5, 1] = False  # no nu in the equation of H, no V in that of nu
    np.testing.assert_array_equal(fixed.pairs, expected)
    moving = made(case, law, moves=dependence(velocity, TRIAL.width))
    expected[:, 1:5] = True
    np.testing.assert_array_equal(moving.pairs, expected)
    assert not np.any(moving(x, U, Z, law, dx)[:, ~expected])


def test_other_values_share_a_plan_and_other_functions_do_not(case, forward_mode):
    mesh, x, U, Z, _, _, _ = case
    first, other = law_of(mesh.n_nodes), law_of(mesh.n_nodes, modulus=-2.5)
    jacobian = made(case, first)
    assert made(case, other)._plan is jacobian._plan
    assert_same(jacobian(x, U, Z, other), forward_mode(FORM, x, U, Z, other, None))
    for factor in (2.0, 3.0):
        changed = law_of(mesh.n_nodes, function=lambda c, factor=factor: factor * c)
        again = made(case, changed)
        assert again._plan is not jacobian._plan
        assert_same(again(x, U, Z, changed), forward_mode(FORM, x, U, Z, changed, None))
        with pytest.raises(ValueError, match="Make a new"):
            jacobian(x, U, Z, changed)
    with pytest.raises(ValueError, match="dx_dU"):
        jacobian(x, U, Z, first, np.zeros((mesh.n_nodes, 3, 6)))


def test_a_form_without_a_plan_is_differentiated_by_jax(case):
    """A loop, and a nodal field that is read where only scalars have a meaning."""
    mesh, x, U, Z, _, rule, _ = case
    U, Z = jnp.asarray(U), jnp.asarray(Z)

    def looped(c):
        return jax.lax.fori_loop(0, 3, lambda _, a: a * c, c)

    def reads(point, trial, frozen, test, law):
        return trial.H.value**2 * test.H.value * jnp.sum(law.field)

    large = Law(jnp.ones(()), jnp.ones(2), cubic, jnp.ones(300))
    looping = law_of(mesh.n_nodes, function=looped)
    for form, law in ((FORM, looping), (Form(reads, TRIAL, FROZEN), large)):
        with pytest.raises(Unsupported):
            made(case, law, form=form)
        found, exact = (
            jax.jit(lambda x, f=f, form=form, law=law: f(form, mesh, rule, x, U, Z, law))(x)
            for f in (planned_cell_jacobians, cell_jacobians)
        )
        np.testing.assert_array_equal(found, exact)


def test_a_large_field_that_is_not_read_costs_nothing(case, forward_mode):
    mesh, x, U, Z, _, _, _ = case
    law = eqx.tree_at(lambda law: law.field, law_of(mesh.n_nodes), jnp.ones(10_000))
    jacobian = made(case, law)
    assert len(jacobian._plan.graph.operations) < 10_000
    assert_same(jacobian(x, U, Z, law), forward_mode(FORM, x, U, Z, law, None))


def stretched(P, args):
    """A density with a cross product, a norm and unstacked components."""
    normal = jnp.cross(P[:3, 1], P[:3, 2])
    a, b, c = P[3:6, 0]
    return args["k"] * jnp.sqrt(jnp.sum(normal**2)) * (a * b + c**3) + jnp.dot(P[:3, 0], P[3:6, 1])


def test_second_derivatives_of_an_integral_have_a_plan_and_are_those_of_jax():
    """Of the nodes and a vector field: symmetric, and equal in compiled functions and outside."""
    mesh, x = icosphere(0, 2)
    rule, pattern = rule_for(mesh, 4), block_pattern(mesh.cells, mesh.n_nodes)
    form = EnergyForm(stretched, Layout(("x", "y"), (3, 3)))
    U, args = jnp.concatenate([x, jnp.sin(2.0 * x) + 1.5], axis=1), {"k": jnp.asarray(0.7)}
    given = form, mesh, rule, x, U, x[:, :0], args
    expected = jax.jit(lambda U: cell_jacobians(*given[:4], U, *given[5:]))(U)
    np.testing.assert_allclose(expected, expected.transpose(0, 2, 1, 4, 3), atol=1e-13)
    planned = jax.jit(lambda U: planned_cell_jacobians(*given[:4], U, *given[5:]))(U)
    np.testing.assert_allclose(planned, expected, atol=1e-13)
    arrays = [np.asarray(a) for a in (x, U, x[:, :0])]
    cells, blocks = np.asarray(mesh.cells), np.asarray(pattern.blocks)
    host = HostJacobian(form, cells, rule, blocks, len(pattern.rows), args)
    np.testing.assert_allclose(host(*arrays, args), scatter_blocks(pattern, expected), atol=1e-13)

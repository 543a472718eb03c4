"""Scalar graphs: the same values and derivatives as JAX, and nothing that is structurally zero."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.fem import Unsupported, dependence
from jaxwillmore.fem._bundle_program import _FUNCTIONS, BundleProgram
from jaxwillmore.fem._elimination import eliminate
from jaxwillmore.fem._expand import MAX_ENTRIES, expand
from jaxwillmore.fem._register_program import Program
from jaxwillmore.fem._scalar_graph import FUNCTIONS, Graph

N = 6
TABLE = np.ones(MAX_ENTRIES + 1)
POINTS = np.random.default_rng(0).uniform(-1.5, 1.5, (7, N))


def graph_of(function):
    """Graph, inputs, outputs and Jacobian of a function of a vector."""
    graph = Graph()
    inputs = [graph.vertex("input", n) for n in range(N)]
    closed = jax.make_jaxpr(function)(jnp.zeros(N))
    (out,) = expand(graph, closed.jaxpr, closed.consts, [np.array(inputs)])
    outputs = [int(k) for k in out.ravel()]
    return graph, inputs, outputs, eliminate(graph, outputs, inputs)


def run(graph, vertices, points):
    program = Program(graph, vertices, N)
    (found,) = program.run(np.zeros(0), [np.ascontiguousarray(points.T)], len(points))
    return found


def evaluated(function, points):
    """Values and dense Jacobians at the points by both programs, which must agree."""
    graph, _, outputs, entries = graph_of(function)
    vertices = outputs + list(entries.values())
    found = run(graph, vertices, points)
    bundled = jax.jit(BundleProgram(graph, vertices))(jnp.asarray(points.T))
    np.testing.assert_allclose(bundled, found, rtol=1e-13, atol=1e-13)
    jacobian = np.zeros((len(points), len(outputs), N))
    for (r, c), values in zip(entries, found[len(outputs) :], strict=True):
        jacobian[:, r, c] = values
    return found[: len(outputs)].T, jacobian


def compared(function, points):
    values, jacobian = evaluated(function, points)
    exact = jax.jit(jax.vmap(function))(points)
    slopes = jax.jit(jax.vmap(jax.jacfwd(function)))(points)
    np.testing.assert_allclose(values, exact.reshape(values.shape), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(jacobian, slopes.reshape(jacobian.shape), rtol=1e-12, atol=1e-12)


@jax.custom_jvp
def straight_through(x):
    return jnp.sign(x)


@straight_through.defjvp
def _(primals, tangents):
    return straight_through(primals[0]), 3.0 * tangents[0]


@jax.custom_vjp
def reversed_rule(x, y):
    return x * y


reversed_rule.defvjp(lambda x, y: (x * y, (x, y)), lambda kept, g: (5.0 * g * kept[1], 7.0 * g))


SMOOTH = {
    "polynomials": lambda v: v**3 - 2.0 * v**-2 + v[::-1] ** 0 * v / (1.0 + v * v),
    "roots": lambda v: jnp.sqrt(1.0 + v**2) * jax.lax.rsqrt(2.0 + v),
    "powers": lambda v: (2.0 + v) ** 2.5 - (2.0 + v) ** -0.5,
    "exponentials": lambda v: jnp.exp(v) * jnp.log(3.0 + v) + jnp.expm1(v) * jnp.log1p(v**2),
    "circular": lambda v: jnp.sin(v) * jnp.cos(v[::-1]) + jnp.tan(0.5 * v) - jnp.arctan(v),
    "hyperbolic": lambda v: jnp.tanh(v) + jnp.sinh(v) / jnp.cosh(v[0]),
    "sigmoids": lambda v: jax.nn.sigmoid(v) + jax.scipy.special.erf(v) + jax.nn.softplus(v),
    "square": lambda v: jnp.square(v) + jax.lax.square(v[0]),
}
PIECEWISE = {
    "where": lambda v: jnp.where(v > 0.2, jnp.sin(v), v**2) + jnp.where(v[0] <= v[1], v, 0.0),
    "logic": lambda v: jnp.where((v > 0) & ~(v >= 1) | (v < -1.0), v, -v),
    "extrema": lambda v: jnp.maximum(v, v[::-1]) * jnp.minimum(v, 0.3) + jnp.max(v) - jnp.min(v),
    "clip": lambda v: jnp.clip(v, -0.5, 0.5) + jax.lax.clamp(-0.3, v, 0.7),
    "modulus": lambda v: jnp.abs(v) * jnp.sign(v[0]) + (v != v[1]).astype(float),
    "finite": lambda v: jnp.where(jnp.isfinite(v), v, 0.0),
}
ARRAYS = {
    "indices": lambda v: v[0] * v[-1] * v[1:4] + v[jnp.array([0, 2, 2])],
    "updates": lambda v: v.at[1].set(2.0).at[2].add(v[0]).at[jnp.array([3, 3])].add(v[0]),
    "slices": lambda v: jax.lax.dynamic_slice(v, (jnp.asarray(1),), (3,)) * v[::2],
    "windows": lambda v: jax.lax.dynamic_update_slice(v, v[:2] ** 2, (jnp.asarray(9),)),
    "matrices": lambda v: v.reshape(2, 3) @ v.reshape(3, 2) + jnp.outer(v[:2], v[2:4]).T,
    "einsum": lambda v: jnp.einsum("bij,bj->bi", v.reshape(2, 1, 3), v.reshape(2, 3)),
    "stacks": lambda v: jnp.concatenate([jnp.stack([v, v**2]), jnp.tile(v, (1, 1))]).T,
    "splits": lambda v: jnp.split(v, 3)[1] + jnp.roll(v, 1)[:2],
    "pads": lambda v: jax.lax.pad(v, v[0], ((-1, 2, 1),)),
    "sums": lambda v: jnp.sum(v.reshape(2, 3), axis=0) + jnp.mean(v) + jnp.prod(v[:3]),
    "geometry": lambda v: jnp.cross(v[:3], v[3:]) / jnp.linalg.norm(v[:3] + 3.0),
    "determinants": lambda v: jnp.linalg.det(jnp.outer(v[:3], v[3:]) + jnp.eye(3)),
    "traces": lambda v: jnp.trace(jnp.diag(v)) + jnp.squeeze(jnp.expand_dims(v, 1), 1),
    "inner functions": lambda v: jax.checkpoint(jax.jit(jnp.sin))(v) * eqx.filter_jit(jnp.cos)(v),
    "reverse mode": jax.grad(lambda v: jnp.sum(jnp.exp(v[:3]) * v[3:] ** 2) + v[0] * v[1] * v[5]),
    "constants": lambda v: v * jnp.cumsum(jnp.arange(6.0)),
}


@pytest.mark.parametrize("name", [*SMOOTH, *PIECEWISE, *ARRAYS])
def test_values_and_derivatives_are_those_of_jax(name):
    compared((SMOOTH | PIECEWISE | ARRAYS)[name], POINTS)


def test_both_programs_know_the_same_operations():
    assert set(FUNCTIONS) == set(_FUNCTIONS)


def test_derivatives_at_a_kink_are_those_of_jax():
    """Half of each branch where two numbers are equal, and none of |x| at zero."""
    kinks = np.array([[0.0, 1.0, 0.0, 1.0, -1.0, 0.0]])
    compared(lambda v: jnp.maximum(v, 0.0) + jnp.minimum(v, v[0]) + jnp.abs(v), kinks)
    compared(jax.nn.relu, kinks)


def test_a_branch_not_taken_does_not_reach_the_derivative():
    """Infinite slopes and logarithms of negative numbers behind `where` leave no NaN."""

    def guarded(v):
        return jnp.where(v > 0, jnp.sqrt(v), v) + jnp.where(v > 0, jnp.log(v), 0.0)

    compared(guarded, np.array([[0.0, -1.0, 2.0, 0.0, 1.0, -2.0]]))


def test_a_function_keeps_the_derivative_it_was_given():
    compared(lambda v: straight_through(v * v[0]) * v, POINTS)
    compared(lambda v: jax.lax.stop_gradient(v**2) * v, POINTS)
    _, jacobian = evaluated(straight_through, POINTS)
    np.testing.assert_array_equal(jacobian, np.broadcast_to(3.0 * np.eye(N), jacobian.shape))
    values, jacobian = evaluated(lambda v: reversed_rule(v[0], v[1]), POINTS)
    np.testing.assert_allclose(values[:, 0], POINTS[:, 0] * POINTS[:, 1])
    np.testing.assert_allclose(jacobian[:, 0, 0], 5.0 * POINTS[:, 1])
    np.testing.assert_allclose(jacobian[:, 0, 1:], 7.0 * np.eye(N)[[1] * len(POINTS), 1:])


def test_equal_expressions_are_one_vertex():
    graph = Graph()
    a, b = graph.vertex("input", 0), graph.vertex("input", 1)
    zero, one = graph.const(0.0), graph.const(1.0)
    assert graph.mul(a, b) == graph.mul(b, a)
    assert graph.add(a, graph.neg(b)) == graph.sub(a, b)
    assert graph.sub(a, a) == graph.mul(a, zero) == zero
    assert graph.mul(graph.neg(a), graph.neg(one)) == graph.add(a, zero) == a
    assert graph.call("exp", zero) == one
    assert graph.call("select", one, b, a) == graph.call("select", a, b, b) - b + a == a


def test_only_entries_that_can_differ_from_zero_are_there():
    """v = V nu + w moves a coordinate by V, by its own component of nu, and of w."""
    pattern = dependence(lambda U: U[0] * U[1:4] + U[4:7], 7)
    eye = np.eye(3, dtype=bool)
    np.testing.assert_array_equal(pattern, np.hstack([np.ones((3, 1), bool), eye, eye]))
    assert not dependence(lambda v: jnp.stack([0.0 * v[0], v[1] - v[1]]), 2).any()


def test_the_gradient_costs_a_multiple_of_the_function():
    """Elimination finds the reverse mode for one output and the forward mode for one input."""

    def deep(v):
        total = jnp.sum(v)
        for _ in range(20):
            total = jnp.tanh(total)
        return total

    for function in (deep, lambda v: v[0] * deep(v[:1]) * jnp.arange(1.0, 7.0)):
        graph, _, outputs, entries = graph_of(function)
        value = Program(graph, outputs, N).n_operations
        both = Program(graph, outputs + list(entries.values()), N).n_operations
        assert value >= 20
        assert both <= 5 * value


def test_chunks_of_points_are_computed_like_one(monkeypatch):
    graph, _, outputs, _ = graph_of(SMOOTH["circular"])
    whole = run(graph, outputs, POINTS)
    monkeypatch.setattr("jaxwillmore.fem._register_program.POINTS_AT_ONCE", 3)
    np.testing.assert_array_equal(run(graph, outputs, POINTS), whole)


@pytest.mark.parametrize(
    "function",
    [
        lambda v: jnp.linalg.eigh(jnp.outer(v, v))[0],
        lambda v: jax.lax.fori_loop(0, 3, lambda i, a: a * v, v),
        lambda v: jnp.cumsum(v),
        lambda v: v[jnp.argmax(v)],
        lambda v: jnp.real(v.astype(complex) ** 2),
        lambda v: 2.0**v,
        lambda v: v * jnp.sum(v[0] * TABLE),
    ],
)
def test_what_has_no_scalar_expression_is_refused(function):
    with pytest.raises(Unsupported):
        graph_of(function)

"""One step as a sparse system: the assembled Jacobian is the derivative of the residual."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.evolve import Stepper
from jaxwillmore.evolve._step import ImplicitStep, LinearStage
from jaxwillmore.evolve._stepper import _safe, column_groups, weights
from jaxwillmore.flows import WillmoreFlow, as_system
from jaxwillmore.mesh import ellipsoid

from ..flows.systems import nodal_data

FLOW = as_system(WillmoreFlow(0.7, 0.5))


@pytest.fixture(scope="module")
def case():
    """A history in the middle of a run, with every field rough."""
    mesh, x = ellipsoid((1.0, 1.2, 1.5), 0, 2)
    stepper = Stepper(FLOW, mesh)
    history = stepper.start(jnp.asarray(0.0), x, {"H": 0 * x[:, 0] + 2.0, "nu": x}, 3)
    for k in (1, 2):
        keys = jr.split(jr.key(k))
        U = history.U[0] + 0.1 * jr.normal(keys[0], history.U[0].shape)
        nodes = history.x[0] + 0.01 * jr.normal(keys[1], x.shape)
        amounts = stepper.amounts(nodes, U)
        history = history.push(jnp.asarray(0.01 * k), nodes, U, amounts, jnp.zeros(0))
    t = jnp.asarray(0.025)
    data = stepper.data(history, weights(history.times, t, 3, 2), t)
    return stepper, history, data


def test_data_of_a_step_are_those_of_the_extrapolated_surface(case):
    """Not of the old one, which would make the step of first order in time."""
    stepper, history, data = case

    def alpha(x, U):
        return nodal_data(FLOW, stepper.problem.mesh, x, stepper.fields(U), t=data.t)["alpha"]

    np.testing.assert_allclose(
        data.data[:, FLOW.data_names.index("alpha")], alpha(data.x_hat, data.hat), rtol=1e-12
    )
    assert abs(float(alpha(history.x[0], history.U[0])[0] / data.data[0, 0]) - 1) > 1e-2


def dense(operator):
    """The matrix, column by column of the identity, as the solver will see it."""
    pattern, data = operator.pattern, np.asarray(operator.data)
    n, fields = pattern.n_nodes, data.shape[-1]
    A = np.zeros((n, n, fields, fields))
    A[np.asarray(pattern.rows), np.asarray(pattern.cols)] = data
    return A.transpose(0, 2, 1, 3).reshape(n * fields, n * fields)


def agree(system, y):
    exact, operator = jax.jit(lambda y: (jax.jacfwd(system.residual)(y), system.jacobian(y)))(y)
    np.testing.assert_allclose(dense(operator), exact, atol=1e-11 * float(jnp.max(jnp.abs(exact))))


def test_the_jacobian_of_the_implicit_step(case):
    """With everything that depends on the new nodes, x = (Vν − x_memory)/c₀."""
    stepper, history, data = case
    system = ImplicitStep(stepper.problem, data)
    y = system.pack(history.U[0], jnp.zeros(0))
    agree(system, y + 0.1 * jr.normal(jr.key(5), y.shape))


@pytest.mark.slow
@pytest.mark.parametrize("stage", [0, 1])
def test_the_jacobian_of_a_linear_stage(case, stage):
    stepper, history, data = case
    system = LinearStage(stepper.problem, data, history.U[0], FLOW.stages[stage])
    y = jr.normal(jr.key(6), system.pack(history.U[0]).shape)
    agree(system, y)
    # Linear: the Jacobian is the same everywhere.
    np.testing.assert_allclose(system.jacobian(y).data, system.jacobian(0 * y).data, atol=1e-12)


def test_packing_is_undone_by_unpacking(case):
    stepper, history, data = case
    system = ImplicitStep(stepper.problem, data)
    U = history.U[0]
    back, multipliers = system.unpack(system.pack(U, jnp.zeros(0)))
    np.testing.assert_allclose(back, U, rtol=1e-14)
    assert multipliers.shape == (0,)
    for stage in FLOW.stages:
        linear = LinearStage(stepper.problem, data, U, stage)
        np.testing.assert_allclose(
            linear.unpack(linear.pack(2 * U)), _doubled(U, stage), rtol=1e-14
        )


def _doubled(U, stage):
    out = np.array(U)
    for name in stage:
        out[:, FLOW.layout.columns(name)] *= 2
    return out


def test_positions_follow_the_velocity(case):
    """c₀ x + x_memory = Vν, the discrete (10e), node by node."""
    stepper, history, data = case
    x = ImplicitStep(stepper.problem, data).positions(history.U[0])
    fields = SimpleNamespace(**stepper.fields(history.U[0]))
    np.testing.assert_allclose(
        data.c0 * x + data.x_memory, fields.V[:, None] * fields.nu, atol=1e-10
    )


def test_groups_of_the_preconditioner_share_factors_between_components():
    """One pair (ν_i, z_i) for each of three components, then (H, V)."""
    assert FLOW.layout.names == ("H", "V", "nu", "z")
    assert column_groups(FLOW.layout, FLOW.stages) == (
        ((2, 5), (3, 6), (4, 7)),
        ((0, 1),),
    )


def test_the_start_of_a_history_and_what_is_known():
    """Orders rise with the number of states, and V = z = 0 starts Newton until two are solved."""
    times = jnp.array([0.3, 0.2, 0.1, 0.0])
    for known, order, used in ((1, 3, 1), (2, 3, 2), (3, 3, 3), (9, 3, 3), (9, 1, 1)):
        w = weights(times, jnp.asarray(0.4), known, order)
        assert int(jnp.sum(w.derivative != 0)) == used + 1
        assert int(jnp.sum(w.hat != 0)) == used
        assert int(jnp.sum(w.guess != 0)) == (2 if known > 2 else 1)
        assert int(jnp.sum(w.predictor != 0)) == min(known, max(order, 2))
        for name in ("hat", "guess", "predictor"):
            assert float(jnp.sum(getattr(w, name))) == pytest.approx(1.0)
        assert float(jnp.sum(w.derivative)) == pytest.approx(0.0, abs=1e-12)


def test_the_error_estimate_can_be_differentiated_at_rest():
    """Nodes that did not move at all: the norm of nothing has the derivative zero here."""
    size = lambda d: jnp.sum(jnp.linalg.norm(_safe(d), axis=1))
    assert bool(jnp.all(jnp.isfinite(jax.grad(size)(jnp.zeros((4, 3))))))

"""States between steps: the requested times, and the order of the interpolation."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.evolve import Stepper
from jaxwillmore.evolve._save import Saver, save_times
from jaxwillmore.evolve._stepper import History
from jaxwillmore.flows import WillmoreFlow
from jaxwillmore.mesh import icosphere


@pytest.mark.parametrize(
    "saveat, t0, t1, expected",
    [
        (None, 0.0, 1.0, []),
        (0.25, 0.0, 1.0, [0.25, 0.5, 0.75, 1.0]),
        (0.3, 0.0, 1.0, [0.3, 0.6, 0.9]),
        (0.1, 0.0, 0.3, [0.1, 0.2, 0.3]),
        (0.1, -0.3, 0.0, [-0.2, -0.1, 0.0]),
        (2.0, 0.0, 1.0, []),
        ([0.0, 0.5], 0.0, 1.0, [0.5]),
        ((1.0,), 0.0, 1.0, [1.0]),
        ([], 0.0, 1.0, []),
    ],
)
def test_save_times(saveat, t0, t1, expected):
    found = save_times(saveat, t0, t1)
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-15)
    assert all(t0 < t <= t1 for t in found)


@pytest.mark.parametrize(
    "saveat", [0.0, -0.1, np.nan, np.inf, [0.5, 0.5], [0.7, 0.3], [-0.1], [1.1], [0.2, np.nan]]
)
def test_bad_save_times_are_refused(saveat):
    with pytest.raises(ValueError, match="`saveat`"):
        save_times(saveat, 0.0, 1.0)


@pytest.fixture(scope="module")
def stepper():
    mesh, _ = icosphere(0, 1)
    return Stepper(WillmoreFlow(), mesh)


def history_of(stepper, times, degree):
    """Nodes and fields that are polynomials of time, at the given times (newest first)."""
    mesh, layout = stepper.problem.mesh, stepper.problem.flow.layout
    rng = np.random.default_rng(0)
    x = rng.normal(size=(degree + 1, mesh.n_nodes, 3))
    U = rng.normal(size=(degree + 1, mesh.n_nodes, layout.width))

    def at(coefficients, t):
        return sum(c * t**k for k, c in enumerate(coefficients))

    history = History(
        jnp.asarray(times),
        jnp.asarray([at(x, t) for t in times]),
        jnp.asarray([at(U, t) for t in times]),
        jnp.zeros((len(times), mesh.n_nodes, 0)),
        jnp.zeros((len(times), 0)),
    )
    return history, lambda t: (at(x, t), stepper.fields(jnp.asarray(at(U, t))))


@pytest.mark.parametrize("order", [1, 2, 4])
def test_polynomials_of_the_order_of_the_scheme_are_interpolated_exactly(stepper, order):
    times = np.array([1.0, 0.7, 0.55, 0.3, 0.1])[: max(order + 1, 3)]
    history, exact = history_of(stepper, times, order)
    saver = Saver([0.8, 0.95, 1.0, 1.2], order)
    # Many states are known, so that the algebraic fields have the full order as well.
    states = saver.passed(stepper, history, 20)
    assert [s.t for s in states] == [0.8, 0.95, 1.0]
    for state in states:
        x, fields = exact(state.t)
        np.testing.assert_allclose(state.x, x, atol=1e-12)
        for name in fields:
            np.testing.assert_allclose(state.fields[name], fields[name], atol=1e-12)
    assert saver.passed(stepper, history, 20) == []  # each time is handed out once


def test_initial_values_that_nobody_knows_stay_out(stepper):
    """After one step V and z exist at one time only; x, H and ν at two."""
    times = np.array([0.2, 0.0, -1.0])
    history, exact = history_of(stepper, times, 1)
    (state,) = Saver([0.1], 2).passed(stepper, history, 2)
    x, fields = exact(0.1)
    np.testing.assert_allclose(state.x, x, atol=1e-13)
    np.testing.assert_allclose(state.H, fields["H"], atol=1e-13)
    np.testing.assert_allclose(state.V, exact(0.2)[1]["V"], atol=1e-13)

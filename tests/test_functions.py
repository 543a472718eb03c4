"""Functions of a user are data: code compiles once, and derivatives pass what they close over."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore._functions import as_data
from jaxwillmore.energies import ExternalPotential, Pressure
from jaxwillmore.evolve import evolve, replay
from jaxwillmore.flows import Forcing, Loads, MeanCurvatureFlow, System, WillmoreFlow
from jaxwillmore.mesh import icosphere
from jaxwillmore.surface import volume


def scaled_by(a):
    return as_data(lambda p: a * jnp.sum(p**2))


def test_a_function_as_data_has_the_values_of_the_function():
    p, word, shift = jnp.arange(3.0), "cos", np.array([1.0, 2.0, 3.0])
    outer = lambda q: jnp.sum(q)

    def plain(p, scale=2.0):
        return scale * outer(getattr(jnp, word)(p) + shift)

    np.testing.assert_array_equal(as_data(plain)(p), plain(p))
    np.testing.assert_array_equal(as_data(plain)(p, scale=0.5), plain(p, 0.5))


def test_the_same_code_with_other_constants_compiles_once():
    traces = []

    @eqx.filter_jit
    def value(function, p):
        traces.append(1)
        return function(p)

    p = jnp.arange(3.0)
    for a in (1.0, 2.5, jnp.asarray(3.0)):
        assert float(value(scaled_by(a), p)) == pytest.approx(5 * float(a))
    assert len(traces) == 1
    value(as_data(lambda p: jnp.sum(p)), p)
    assert len(traces) == 2


def test_what_is_no_plain_function_stays_as_it_is():
    class Potential(eqx.Module):
        a: float

        def __call__(self, p):
            return self.a * p

    potential = Potential(2.0)
    assert as_data(potential) is potential and as_data(jnp.sin) is jnp.sin

    def keyword(p, *, a=1.0):
        return a * p

    def itself(p):
        return itself(p - 1) if p > 0 else p

    assert as_data(keyword) is keyword and as_data(itself) is itself


@pytest.fixture(scope="module")
def sphere():
    return icosphere(0, degree=1)


@pytest.mark.parametrize(
    "flow_of",
    [
        lambda a, V: MeanCurvatureFlow(lambda H: a * H),
        lambda a, V: System(MeanCurvatureFlow(), Forcing(lambda t, p: a * (1 + p[2]))),
        lambda a, V: System(MeanCurvatureFlow(), Loads(volume=lambda t: V * (1 - a * t))),
        lambda a, V: System(
            MeanCurvatureFlow(),
            Loads(Pressure(1.0) + ExternalPotential(lambda p: a * p[0] ** 2)),
        ),
    ],
    ids=["speed", "forcing", "held volume", "potential"],
)
def test_a_run_has_derivatives_by_what_a_function_closes_over(sphere, flow_of):
    mesh, x = sphere
    V, times = volume(mesh, x), jnp.array([0.0, 5e-3, 1e-2])

    def end(a):
        run = replay(flow_of(a, V), mesh, x, times, newton_tolerance=1e-13)
        return jnp.sum(run.x[-1] ** 2 * jnp.array([[1.0, 2.0, 3.0]]))

    slope = jax.grad(end)(0.7)
    difference = (end(0.7 + 1e-4) - end(0.7 - 1e-4)) / 2e-4
    assert abs(float(slope)) > 1e-3
    np.testing.assert_allclose(slope, difference, rtol=1e-6)


def test_other_parameters_and_times_compile_nothing(sphere):
    """The second call of `evolve` and of `replay`, outside of any `jit` of the user."""
    mesh, x = sphere
    x, compiled = x.at[:, 2].multiply(1.2), []

    def seen(event, _, **__):
        if "backend_compile" in event:
            compiled.append(event)

    def run(H0, t1):
        evolve(WillmoreFlow(0.5, H0), mesh, x, t1=t1)
        times = jnp.linspace(0.0, t1, 3)
        volume(mesh, replay(WillmoreFlow(0.5, H0), mesh, x, times).x[-1])

    run(0.0, 1e-3)
    jax.monitoring.register_event_duration_secs_listener(seen)
    try:
        run(0.1, 1.2e-3)
        assert not compiled
        jax.jit(lambda p: p + jnp.arange(7.0))(x[:7, 0])
        assert compiled  # the listener hears
    finally:
        jax.monitoring.clear_event_listeners()

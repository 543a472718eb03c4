"""Observers: `True` ends what they watch, complete and without an error; nothing else does."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import equilibria, evolve, fit, flows
from jaxwillmore._observers import asks_to_stop
from jaxwillmore.mesh import ellipsoid

MESH, X = ellipsoid((1.0, 1.0, 1.3), 1, 1)


@pytest.mark.parametrize("answer", [None, False, 0, 1, "yes", [1], np.False_, jnp.array(True)])
def test_only_true_asks_to_stop(answer):
    assert not asks_to_stop(answer)
    assert asks_to_stop(True) and asks_to_stop(np.True_)


class Watch:
    """An observer that answers `answer` at its second step."""

    def __init__(self, answer):
        self.answer, self.rows = answer, []

    def __call__(self, row, *rest):
        self.rows.append(row)
        return self.answer if len(self.rows) == 2 else None


def test_a_run_ends_where_its_observer_says_true():
    """No error, although `throw` is on; with any other answer it goes on."""
    watch = Watch(True)
    flow, options = flows.WillmoreFlow(), {"dt0": 1e-3, "rtol": None, "energy_tolerance": None}
    run = evolve.evolve(flow, MESH, X, t1=0.01, observer=watch, **options)
    assert evolve.name_of(run.result) == "stopped" and not run.succeeded
    assert len(run.records) == len(watch.rows) == 2 and run.state.t == run.times[-1]
    watch = Watch("stop")
    run = evolve.evolve(flow, MESH, X, t1=0.01, max_steps=3, throw=False, observer=watch, **options)
    assert len(watch.rows) == 3 and evolve.name_of(run.result) == "step_limit"


def test_a_search_ends_where_its_observer_says_true():
    watch = Watch(True)
    mesh, x = equilibria.spheroid(0.8, level=1)
    shape = equilibria.equilibrium(mesh, x, reduced_volume=0.8, stability=False, observer=watch)
    assert equilibria.name_of(shape.result) == "stopped" and not shape.succeeded
    assert len(watch.rows) == shape.stats["outer_steps"] == 2


@pytest.mark.slow
def test_a_fit_ends_where_its_observer_says_true():
    build = lambda p: flows.WillmoreFlow(p["bending_modulus"])
    run = evolve.evolve(build({"bending_modulus": 0.7}), MESH, X, t1=0.01)
    watch = Watch(True)
    found = fit.fit_flow(
        build,
        MESH,
        X,
        [0.01],
        [(MESH, run.state.x)],
        start={"bending_modulus": 0.4},
        observer=watch,
    )
    assert fit.name_of(found.result) == "stopped" and not found.succeeded
    assert len(watch.rows) == 2

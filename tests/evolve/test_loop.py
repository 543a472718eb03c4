"""What the loop accepts, with laws on an octahedron at rest whose answers are known by heart."""

import functools as ft
import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import FreeEnergy, GinzburgLandau
from jaxwillmore.evolve import Stepper, _evolve, evolve, name_of
from jaxwillmore.evolve._evolve import _newton_tolerance
from jaxwillmore.evolve._loop import Loop
from jaxwillmore.evolve._step import ImplicitStep
from jaxwillmore.evolve._stepper import weights
from jaxwillmore.flows import (
    AbstractLaw,
    CahnHilliard,
    Field,
    Mixing,
    Statement,
    System,
    WillmoreFlow,
)
from jaxwillmore.mesh import SurfaceMesh

UP = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4)]
MESH = SurfaceMesh(np.array(UP + [(b, a, 5) for a, b, _ in UP]), 1, 6)
X = jnp.asarray([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
ZERO = {"u": jnp.zeros(6)}


class Clock(AbstractLaw):
    """u' = g(u) at every node, with the energy ∫G(u) that nobody promised to lower."""

    rate: Callable = eqx.field(static=True)
    density: Callable = eqx.field(static=True)

    def statement(self):
        equation = lambda s, chi: (s.rate.u - self.rate(s.trial.u.value)) * chi.value
        one = lambda _: jnp.ones(())
        return Statement(
            fields=(Field("u", equation, one, role="material", error_weight=1.0),),
            start=lambda mesh, x, given: {"u": given["u"]},
            energy=FreeEnergy(self.density),
            implicit_only=True,
        )


def constant(u):
    return jnp.ones_like(u)


def decay(u):
    return -u


def rising(u):
    return 1.0 + u


def falling(u):
    return 1.0 - u


run = ft.partial(evolve, mesh=MESH, x0=X, initial=ZERO, throw=False)


@pytest.fixture(scope="module")
def judge():
    """How many steps with these rises of the energy, in tolerances, are accepted in a row."""
    tolerance, size, made = 1e-3, 2.0, []

    def kept(*args, **keywords):
        made.append(Loop(*args, **keywords))
        return made[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_evolve, "Loop", kept)
        run(Clock(constant, falling), t1=0.9, max_steps=1, energy_tolerance=tolerance)
    (loop,) = made
    t = jnp.asarray(loop.state.t + 1e-3)
    solved = loop.advance(loop.history, weights(loop.history.times, t, 2, 2), t)

    def accepted(rises, **record):
        loop.size, loop.floor, loop.least, energy = size, 0.1 * size, 1.0, 1.0
        for k, rise in enumerate(rises):
            new = energy + rise * tolerance * size
            if loop._judge(solved, record | {"energy": new}, energy)[0] is not None:
                return k
            energy, loop.least = new, min(loop.least, new)
        return len(rises)

    return accepted


def test_rises_of_the_energy_add_up_to_no_more_than_300_tolerances(judge):
    """Each may be as large as the tolerance, not larger, and all of them 300 times that."""
    assert judge(1000 * [0.7]) == 428
    assert judge([0.99, 1.01, 0.99]) == 1
    # They are counted from the least energy so far.
    assert judge(400 * [0.7] + [-500.0] + 600 * [0.7]) == 829


def test_cells_that_turned_over_and_energies_without_a_value_are_refused(judge):
    """The alignment is the least mean of n·ν over a cell: 1 at rest, 0 where one stands upright."""
    assert judge([0.0], alignment=0.1) == 1
    assert judge([0.0], alignment=0.0) == judge([0.0], alignment=-0.1) == 0
    assert judge([math.nan]) == judge([-math.inf]) == 0


@pytest.mark.slow
def test_a_run_whose_energy_creeps_up_ends():
    """E' = |Γ| > 0: the step shrinks until every rise is allowed, and all of them reach 300."""
    tolerance = 1e-3
    solution = run(Clock(constant, rising), t1=10.0, dt0=1e-4, energy_tolerance=tolerance)
    assert name_of(solution.result) == "energy_rising"
    energies = np.array([record["energy"] for record in solution.records])
    # What a rise is relative to is the energy of the moment, here its only term.
    total = (energies[-1] - energies[0]) / (tolerance * energies[-1])
    assert 290 < total <= 300, total
    assert np.all(np.diff(energies) <= 1.001 * tolerance * energies[1:])


@pytest.mark.parametrize("rate, end", [(4e-6, "reached_t1"), (4e-5, "energy_rising")])
def test_where_all_terms_vanish_a_rise_is_relative_to_a_tenth_of_their_size_at_the_start(rate, end):
    """E/|Γ| = 1 − t up to t = 1, then rate·(t − 1) in steps of 0.1: 0.4 and 4 of 1e-5/10."""
    relu = lambda u: jnp.maximum(u, 0.0)
    law = Clock(constant, lambda u: relu(1.0 - u) + rate * relu(u - 1.0))
    solution = run(law, t1=1.2, rtol=None, dt0=0.1)
    assert name_of(solution.result) == end
    # Rises are counted from the least energy on the way, which is not the last one.
    energies = [record["energy"] for record in solution.records]
    assert solution.continuation.least == min(energies)
    assert len(energies) == 10 or min(energies) < energies[-1]


def test_every_accepted_step_has_an_error_within_the_tolerance():
    """u' = −u from 1: what is accepted is below `rtol`, and the next step aims at it."""
    solution = run(Clock(decay, lambda u: u**2), t1=1.0, dt0=0.5, initial={"u": jnp.ones(6)})
    errors = np.array([record["error"] for record in solution.records])
    assert solution.stats["rejected_steps"] > 0 and np.all(errors <= 1e-3)
    assert np.median(errors[2:-2]) > 5e-4
    # The local errors of a decay do not add up: e⁻¹ to a few tolerances.
    np.testing.assert_allclose(solution.state.fields["u"], math.exp(-1.0), atol=5e-3)


def test_a_run_ends_with_two_equal_steps():
    solution = run(Clock(constant, falling), t1=1.0, dt0=0.3)
    steps = np.diff(solution.times)
    assert solution.times[-1] == 1.0 and steps[-1] == pytest.approx(steps[-2], rel=1e-12)


def test_an_energy_without_terms_is_no_obstacle():
    """E = 0 and so is its size, as of a surface that is all of one phase: nothing rises."""
    solution = run(Clock(jnp.zeros_like, lambda u: u**2), t1=1.0, dt0=0.5)
    assert name_of(solution.result) == "reached_t1"
    assert {record["energy"] for record in solution.records} == {0.0}


@pytest.fixture(scope="module")
def stepper():
    return Stepper(WillmoreFlow(), MESH)


@pytest.mark.parametrize("order, known", [(1, 2), (2, 3), (3, 4)])
def test_the_local_error_of_a_power_of_time_has_a_closed_form(stepper, order, known):
    """x = (1 + tᵖ)X is predicted from p points up to ∏(t − t_j), relative to the extent, over
    q + 1."""
    times, t = jnp.array([0.3, 0.2, 0.05, 0.0]), jnp.asarray(0.45)
    history = stepper.start(jnp.asarray(0.0), X, {"H": 0 * X[:, 0], "nu": X}, len(times))
    points = min(known, max(order, 2))
    power = lambda t: (1 + t**points) * X
    history = eqx.tree_at(
        lambda h: (h.times, h.x), history, (times, jnp.stack([power(s) for s in times]))
    )

    @eqx.filter_jit
    def error(history):
        w = weights(times, t, known, order)
        data = stepper.data(history, w, t)
        return stepper.local_error(history, w, power(t), history.U[0], data)

    found = error(history)
    extent = 2 * (1 + times[0] ** points)
    expected = jnp.prod(t - times[:points]) / extent / (order + 1)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_newton_is_a_hundred_times_as_exact_as_the_steps():
    """And ten times as exact as what counts as rest; 1e-8 where steps are fixed."""
    assert _newton_tolerance(1e-3, None) == pytest.approx(1e-5)
    assert _newton_tolerance(1e-3, 1e-6) == pytest.approx(1e-7)
    assert _newton_tolerance(1e-3, 1.0) == pytest.approx(1e-5)
    assert _newton_tolerance(None, 1e-3) == 1e-8


def test_amounts_are_exact_whatever_newton_leaves():
    """Any c plus the constant that makes the equations of a step, added over all nodes, true."""
    mixing = Mixing(GinzburgLandau(1.0, 0.5))
    stepper, t = Stepper(System(CahnHilliard(), mixing), MESH), jnp.asarray(0.1)
    c = jnp.array([0.1, 0.9, 0.3, 0.5, 0.2, 0.7])
    history = stepper.start(jnp.asarray(0.0), X, {"c": c}, 3)
    off = history.U[0] + jnp.array([[0.01, 3.0]])

    @eqx.filter_jit
    def mended(U):
        data = stepper.data(history, weights(history.times, t, 1, 2), t)
        return ImplicitStep(stepper.problem, data).with_exact_amounts(U, jnp.zeros(0))

    exact = mended(off)
    found, expected = (jnp.sum(stepper.amounts(X, U)) for U in (exact, history.U[0]))
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    np.testing.assert_allclose(exact[:, 0], c, atol=1e-13)

"""Two phases from shape and concentration: a twin, intervals, refusals."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.energies import Mixture, TwoPhase
from jaxwillmore.fit import match_phases, name_of

TRUTH = {"line_tension": 4.0, "contrast": 1.2}
START = {name: 0.5 * value for name, value in TRUTH.items()}
WIDTH = 0.5


def build(p):
    return TwoPhase(0.5, Mixture(0.0, p["contrast"]), 0.0, p["line_tension"], WIDTH)


def energy(values):
    return build({name: jnp.asarray(value) for name, value in values.items()})


@pytest.fixture(scope="module")
def sphere():
    return jw.mesh.icosphere(0, degree=2)


# 1. What is found.
@pytest.fixture(scope="module")
def model():
    """A vesicle of reduced volume 0.85 with one interface, at the start values."""
    mesh, x = jw.mesh.ellipsoid((0.712, 0.712, 1.677), 0, degree=2)
    c = jw.phases.stripe(mesh, x, WIDTH, 0.5)
    return jw.equilibria.equilibrium(
        mesh, x, energy(START), c=c, reduced_volume=0.85, stability=False
    )


@pytest.fixture(scope="module")
def twin(model):
    """The same at the truth, on the reference of the model."""
    there = eqx.tree_at(lambda p: p.two_phase, model.parameters, energy(TRUTH))
    found = jw.equilibria.resolve(model, there)
    assert bool(found.converged)
    return model.mesh, found.x, found.c


@pytest.mark.slow
def test_a_twin_is_found_from_half_the_values(model, twin):
    fit = match_phases(build, twin, model, start=START, new_references=False)
    for name, value in TRUTH.items():
        np.testing.assert_allclose(fit.parameters[name], value, rtol=1e-6)
    assert fit.rms < 1e-8 and fit.rms_concentration < 1e-8
    assert fit.verdict.word == "agrees" and fit.verdict.warnings == ()
    assert fit.in_words()[0] == fit.verdict.sentence and "ratios" in fit.in_words()[1]
    # What is said of the solution belongs to the parameters found, not to those of the start.
    assert fit.solution is not None
    there = eqx.tree_at(lambda p: p.two_phase, model.parameters, energy(TRUTH))
    expected = jw.equilibria.resolve(model, there)
    for name in ("total_energy", "tension", "pressure", "chemical_potential"):
        found = getattr(fit.solution, name)
        np.testing.assert_allclose(found, getattr(expected, name), rtol=1e-6)


@pytest.mark.slow
def test_a_kept_reference_needs_an_energy_of_the_same_kind(model, twin):
    other = lambda p: TwoPhase(0.5, p["contrast"], 0.0, p["line_tension"], WIDTH)
    with pytest.raises(ValueError, match="of the kind that `build` makes"):
        match_phases(other, twin, model, start=START, new_references=False)


@pytest.mark.slow
def test_a_larger_twin_elsewhere_is_found_on_new_references(model, twin):
    """The reference moves with the model: the error is that of 42 nodes."""
    mesh, x, c = twin
    fit = match_phases(build, (mesh, 2.0 * x + 1.0, c), model, start=START)
    for name, value in TRUTH.items():
        np.testing.assert_allclose(fit.parameters[name], value, rtol=1e-3)
    np.testing.assert_allclose(fit.x, 2.0 * x + 1.0, atol=1e-3)


@pytest.mark.slow
def test_what_scales_everything_is_not_identifiable(model):
    """Moduli, line tension and all multipliers times one number: the same shape."""

    def scaled(p):
        return TwoPhase(p["bending_modulus"], Mixture(0.0, 0.6), 0.0, p["line_tension"], WIDTH)

    start = {"bending_modulus": 0.5, "line_tension": 2.0}
    near = jw.equilibria.equilibrium(
        model.mesh,
        model.x,
        scaled({name: jnp.asarray(value) for name, value in start.items()}),
        c=model.c,
        reduced_volume=0.85,
        stability=False,
    )
    seen = near.mesh, near.x, near.c
    fit = match_phases(scaled, seen, near, start=start, new_references=False, throw=False)
    assert name_of(fit.result) == "not_identifiable"
    assert fit.identification.rank == 1
    assert "combination" in fit.in_words()[2]


# 2. What is refused.
def looked_at(c):
    """Enough of an equilibrium, of free volume, to be refused."""
    model = object.__new__(jw.equilibria.Equilibrium)
    object.__setattr__(model, "c", c)
    object.__setattr__(model, "fixed_volume", False)
    return model


@pytest.mark.parametrize(
    "c, has_phases, start, noise, message",
    [
        (0.5 * np.ones(41), True, START, None, "one concentration per node, 42"),
        (np.full(42, np.nan), True, START, None, "not finite"),
        (0.5 * np.ones(42), False, START, None, "`model` has one phase"),
        (0.5 * np.ones(42), True, {}, None, "`start` is empty"),
        (0.5 * np.ones(42), True, START, (0.01, 0.0), "two positive numbers"),
        (0.5 * np.ones(42), True, {"line_tension": -1.0}, None, "Start of `line_tension`"),
        (0.5 * np.ones(42), True, {"mean": 1.2}, None, "Start of `mean`"),
        (0.5 * np.ones(42), True, {"reduced_volume": 0.8}, None, "has a free volume"),
    ],
)
def test_what_cannot_be_fitted_is_refused(sphere, c, has_phases, start, noise, message):
    mesh, x = sphere
    model = looked_at(c if has_phases else None)
    with pytest.raises(ValueError, match=message):
        match_phases(build, (mesh, x, c), model, start=start, noise=noise)

"""Fits to time series: the modulus from the rate of motion, and refusals."""

import numpy as np
import pytest

from jaxwillmore.evolve import evolve
from jaxwillmore.fit import RESULTS, Between, _flow, fit_flow, name_of
from jaxwillmore.fit._flow_residuals import Schedule
from jaxwillmore.flows import WillmoreFlow
from jaxwillmore.mesh import ellipsoid, icosphere

MESH, X = ellipsoid((1.0, 1.2, 1.5), 0, 2)
TIMES = [0.002, 0.005, 0.01, 0.02, 0.04]
MODULUS = 0.7


def build(p):
    return WillmoreFlow(p["bending_modulus"])


@pytest.mark.slow
def test_a_flow_tells_its_modulus():
    """From half the value; the data have five times the time steps of the fit's schedule."""
    run = evolve(WillmoreFlow(MODULUS), MESH, X, t1=TIMES[-1], rtol=1e-5, saveat=TIMES)
    seen = [(MESH, state.x) for state in run.saved[-len(TIMES) :]]
    fit = fit_flow(build, MESH, X, TIMES, seen, start={"bending_modulus": 0.5 * MODULUS}, rtol=1e-4)
    assert fit.succeeded, name_of(fit.result)
    np.testing.assert_allclose(fit.parameters["bending_modulus"], MODULUS, rtol=1e-3)
    assert fit.identification.identifiable == {"bending_modulus": True}
    low, high = fit.identification.intervals()["bending_modulus"]
    assert low < fit.parameters["bending_modulus"] < high


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.2, 0.1], 2 * [(MESH, X)]), "must increase"),
        (([0.1], []), "1 times for 0 observations"),
        (([0.0], [(MESH, X)]), "must increase from t0"),
        (([0.1], [(MESH, -X)]), "inside out"),
        (([0.1], [(MESH, np.nan * np.asarray(X))]), "not finite"),
    ],
)
def test_wrong_observations_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        fit_flow(build, MESH, X, *arguments, start={"bending_modulus": 1.0})


def test_a_start_out_of_range_is_refused():
    with pytest.raises(ValueError, match="between 1 and 2"):
        fit_flow(
            build,
            MESH,
            X,
            [0.1],
            [(MESH, X)],
            start={"bending_modulus": 3.0},
            ranges={"bending_modulus": Between(1.0, 2.0)},
        )


def test_a_start_whose_run_breaks_off_ends_by_name(monkeypatch):
    """Without a schedule there is no model: no parameters are told, and no success."""
    broken = lambda *arguments: Schedule((1,), np.array([0.0, 0.1]), RESULTS.model_failed)
    monkeypatch.setattr(_flow, "schedule", broken)
    start = {"bending_modulus": 1.0}
    fit = fit_flow(build, MESH, X, [0.1], [(MESH, X)], start=start, throw=False)
    assert name_of(fit.result) == "model_failed" and not fit.succeeded
    assert np.isnan(fit.rms) and fit.parameters == start
    assert fit.in_words() == (
        "The fit has no solution, so that it says nothing about its parameters.",
    )
    assert fit.identification.identifiable == {"bending_modulus": False}


@pytest.mark.slow
def test_a_sphere_at_rest_does_not_tell_its_modulus():
    """Nothing moves, so that any modulus fits; the one that is found is no finding."""
    mesh, x = icosphere(0, degree=2)
    fit = fit_flow(build, mesh, x, [0.01], [(mesh, x)], start={"bending_modulus": 1.0}, throw=False)
    assert not fit.succeeded
    assert fit.identification.identifiable == {"bending_modulus": False}
    assert "bending_modulus is not identifiable from these data." in fit.in_words()

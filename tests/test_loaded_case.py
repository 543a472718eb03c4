"""Flows from case files with energies of the whole surface, constraints and ramps."""

import json

import numpy as np
import pytest

from jaxwillmore.cases import CaseError, load_case
from jaxwillmore.fem import integrate
from jaxwillmore.flows import MinimalDeformation, WillmoreFlow
from jaxwillmore.health import _warnings
from jaxwillmore.io import read_history
from jaxwillmore.runs import run_case
from jaxwillmore.runs._flow import Ramp, flow_of
from jaxwillmore.runs._start import starting_surface
from jaxwillmore.surface import area, volume

SURFACE = {"shape": "ellipsoid", "semi_axes": [1.0, 1.0, 1.3], "level": 1, "degree": 1}
BASE = {
    "surface": SURFACE,
    "flow": {"tangential": "none"},
    "time": {"t1": 0.004, "dt0": 1e-3},
    "output": {"picture": False, "frames": False},
}


def case_of(**sections):
    return load_case(
        {name: {**BASE.get(name, {}), **sections.get(name, {})} for name in {*BASE, *sections}}
    )


@pytest.fixture(scope="module")
def sizes():
    start = starting_surface(case_of())
    return float(area(start.mesh, start.x)), float(volume(start.mesh, start.x))


@pytest.fixture(scope="module")
def loaded(tmp_path_factory, sizes):
    """Every energy at once."""
    osmotic = {"solute_amount": 5.0, "ambient_concentration": 1.0, "temperature": 2.0}
    bilayer = {"nonlocal_modulus": 0.1, "preferred_difference": 0.3, "thickness": 0.01}
    energy = {
        "osmotic": {**osmotic, "gas_constant": 1.0},
        "area_difference": bilayer,
        "area_penalty": {"stretching_modulus": 0.3},
        "volume_penalty": {"strength": 0.4, "preferred_volume": 4.0},
        "tension": 0.2,
        "pressure": -0.1,
        "gaussian_modulus": 0.5,
    }
    return run_case(case_of(energy=energy), tmp_path_factory.mktemp("loaded") / "out")


def test_multipliers_are_the_slopes_of_the_energies(loaded, sizes):
    summary, (A0, _) = loaded.summary, sizes
    A, V = summary["area"], summary["volume"]
    row = read_history(loaded.folder / "history.csv")[-1]
    # M = ∫H_h is known through m alone: solve for it, then compare the other slope.
    m, kappa_r, D = summary["multipliers"]["curvature"], 0.1, 0.01
    excess = m * A * D / (kappa_r * np.pi)
    tension = 0.2 + 0.3 * (A - A0) / A0 - kappa_r * np.pi / (2 * A**2 * D**2) * excess**2
    pressure = -0.1 + 2.0 * (5.0 / V - 1.0) - 0.4 * (V / 4.0 - 1) / 4.0
    # Newton's tolerance is 1e-8 of the scale of a force.
    assert summary["multipliers"]["tension"] == pytest.approx(tension, abs=1e-6)
    assert summary["multipliers"]["pressure"] == pytest.approx(pressure, abs=1e-6)
    assert row["tension"] == summary["multipliers"]["tension"]
    M = (excess + 0.3) / D
    assert M == pytest.approx(_total_mean_curvature(loaded), rel=1e-2)


def _total_mean_curvature(run):
    state = run.solution.state
    return float(integrate(run.solution.mesh, state.x, lambda _, f: f.H.value, {"H": state.H}))


def test_the_summary_of_a_flow_has_the_keys_of_all_commands(loaded):
    summary = json.loads((loaded.folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["negative_directions"] is None and summary["stationarity"] > 0
    R0 = np.sqrt(summary["area"] / (4 * np.pi))
    of = summary["multipliers"]
    assert of["scaled_tension"] == pytest.approx(of["tension"] * R0**2, rel=1e-12)
    assert of["scaled_pressure"] == pytest.approx(of["pressure"] * R0**3, rel=1e-12)
    bending = summary["willmore"] / (8 * np.pi)
    assert summary["bending_over_8pi_kappa"] == pytest.approx(bending, rel=1e-12)
    assert summary["gaussian_energy"] == pytest.approx(4 * np.pi * 0.5, rel=1e-14)
    assert summary["health"] == []


@pytest.mark.slow
def test_a_ramp_takes_the_volume_to_its_number_and_stays(tmp_path, sizes):
    _, V0 = sizes
    case = case_of(
        constraints={"volume": 0.99 * V0, "ramp": 0.002}, time={"stop_when_stationary": 0.0}
    )
    run = run_case(case, tmp_path / "out")
    assert run.succeeded
    for row in read_history(run.folder / "history.csv"):
        expected = V0 * (1 - 0.01 * min(row["t"] / 0.002, 1.0))
        np.testing.assert_allclose(row["volume"], expected, rtol=1e-9)


def test_nodes_move_with_the_least_deformation_unless_told_otherwise(sizes):
    start = starting_surface(case_of())
    moving = flow_of(load_case({"surface": SURFACE, "time": {"t1": 1.0}}), start.mesh, start.x)
    assert [type(law) for law in moving.laws] == [WillmoreFlow, MinimalDeformation]
    resting = flow_of(case_of(), start.mesh, start.x)
    assert [type(law) for law in resting.laws] == [WillmoreFlow]


def test_a_ramp_is_linear_between_its_ends():
    ramp = Ramp(2.0, 4.0, 1.0, 0.5)
    np.testing.assert_allclose([ramp(t) for t in (0.0, 1.0, 1.25, 1.5, 9.0)], [2, 2, 3, 4, 4])


def test_a_fatal_warning_ends_a_flow_at_its_step(tmp_path, monkeypatch):
    monkeypatch.setattr(_warnings, "UNRESOLVED", 1e-9)
    run = run_case(case_of(output={"fatal_warnings": True}), tmp_path / "out")
    assert run.summary["status"] == "unhealthy" and not run.succeeded
    assert "large against the radii" in run.summary["message"]
    assert run.summary["steps"] == 1 and len(read_history(run.folder / "history.csv")) == 2
    assert (run.folder / "final.npz").is_file()


@pytest.mark.parametrize(
    "sections, words",
    [
        ({"constraints": {"area": 20.0}}, ["[constraints] area", "not 20", "Scale"]),
        ({"constraints": {"volume": 5.0}}, ["[constraints] volume", "not 5", "`ramp`"]),
        (
            {"constraints": {"area": "initial", "reduced_volume": 0.5}},
            ["[constraints] reduced_volume", "not 0.5", "`ramp`"],
        ),
        ({"constraints": {"volume": 5.0, "ramp": 1.0}}, ["[constraints] ramp", "t1 - t0 = 0.004"]),
        (
            {"constraints": {"area": "initial", "volume": 50.0, "ramp": 0.001}},
            ["[constraints] volume", "<= ", "sphere"],
        ),
        (
            {
                "surface": {"semi_axes": [1.0, 1.0, 1.0], "degree": 2},
                "constraints": {"area": "initial", "reduced_volume": 0.9, "ramp": 0.001},
            },
            ["[constraints] reduced_volume", "is a sphere"],
        ),
        (
            {
                "energy": {"osmotic": {"solute_amount": 1.0, "ambient_concentration": 1.0}},
                "flow": {"scheme": "linearly-implicit"},
            },
            ["[flow] scheme", "implicit"],
        ),
    ],
)
def test_what_a_flow_cannot_hold_is_refused_before_anything_is_written(tmp_path, sections, words):
    with pytest.raises(CaseError) as caught:
        run_case(case_of(**sections), tmp_path / "out")
    for word in words:
        assert word in str(caught.value), str(caught.value)
    assert not (tmp_path / "out").exists()

"""Cases with a concentration: what is refused, what a run leaves."""

import csv
import json
import math

import numpy as np
import pytest

from jaxwillmore.cases import CaseError, example_path, load_case
from jaxwillmore.flows import AllenCahn, CahnHilliard, HelfrichFlow, Loads, Mixing, WillmoreFlow
from jaxwillmore.phases import amount
from jaxwillmore.runs import run_branch, run_case, run_equilibrium
from jaxwillmore.runs._flow import flow_of
from jaxwillmore.runs._start import starting_surface

REST = """
[surface]
shape = "red_cell"
level = 1
[phase]
law = "cahn-hilliard"
line_tension = 1.0
interface_width = 0.35
start = "spinodal"
mean = 0.4
amplitude = 0.05
seed = 1
[flow]
kind = "phase"
[time]
t1 = 0.5
max_steps = 4
"""

COUPLED = """
[surface]
shape = "ellipsoid"
semi_axes = [1.0, 1.0, 1.5]
level = 0
[phase]
line_tension = 1.0
interface_width = 0.5
bending_modulus = [0.5, 0.8]
spontaneous_curvature = [0.0, 0.5]
start = "stripe"
[constraints]
area = "initial"
reduced_volume = "initial"
[time]
t1 = 1.0
max_steps = 3
[output]
picture = false
"""


@pytest.mark.parametrize(
    "change, key, words",
    [
        (("interface_width = 0.35", "interface_width = 0.02"), "interface_width", "0.4"),
        (("mean = 0.4", "mean = 1.2"), "mean", "< 1"),
        (("line_tension = 1.0", "line_tension = -1.0"), "line_tension", "> 0"),
        (("seed = 1", "mobility = 0.0"), "mobility", "> 0"),
        (("seed = 1", "kinetic_coefficient = 2.0"), "kinetic_coefficient", "allen-cahn"),
        (("seed = 1", 'file = "c.npy"'), "file", 'start = "file"'),
        (("line_tension = 1.0\n", ""), "line_tension", "needs a number > 0"),
        (
            ("seed = 1", "entropy_coefficient = 1.0"),
            "entropy_coefficient",
            'well = "flory-huggins"',
        ),
        (("seed = 1", "bending_modulus = [0.5, 1.0]"), "bending_modulus", "at rest"),
        (("seed = 1", 'law = "allen-cahn"\ndegenerate = true'), None, None),
    ],
)
def test_what_makes_no_concentration_is_refused_by_key(change, key, words):
    text = REST.replace(*change)
    if key is None:
        text = text.replace('law = "cahn-hilliard"\n', "", 1)
        key, words = "degenerate", "cahn-hilliard"
    with pytest.raises(CaseError) as caught:
        case = load_case(text)
        starting_surface(case)
    assert caught.value.section == "phase" and caught.value.key == key
    assert words in str(caught.value)


def test_a_flory_huggins_energy_needs_two_wells():
    quartic = "line_tension = 1.0\ninterface_width = 0.35\n"
    other = 'well = "flory-huggins"\nentropy_coefficient = 1.0\ninteraction = 1.9\n'
    other += "gradient_coefficient = 0.2\n"
    with pytest.raises(CaseError, match="2 entropy_coefficient = 2"):
        load_case(REST.replace(quartic, other))
    load_case(REST.replace(quartic, other.replace("1.9", "3.0")))


def test_moduli_stand_in_one_place():
    with pytest.raises(CaseError, match="belongs into \\[phase\\]"):
        load_case(COUPLED + "[energy]\nbending_modulus = 0.5\n")
    with pytest.raises(CaseError, match="needs a section \\[phase\\]"):
        load_case(REST.replace(REST[REST.index("[phase]") : REST.index("[flow]")], ""))
    with pytest.raises(CaseError, match="`line_tension` belongs to \\[phase\\]"):
        load_case("[surface]\nshape='sphere'\n[energy]\nline_tension=1.0\n[time]\nt1=1.0")
    with pytest.raises(CaseError, match="> 0"):
        load_case(COUPLED.replace("[0.5, 0.8]", "[0.5, -0.8]"))


def test_a_file_gives_the_start(tmp_path):
    text = REST.replace('start = "spinodal"\nmean = 0.4\n', 'start = "file"\nfile = "c.npy"\n')
    path = tmp_path / "case.toml"
    path.write_text(text)
    np.save(tmp_path / "c.npy", np.full(7, 0.3))
    with pytest.raises(CaseError, match="each of the 162 nodes"):
        starting_surface(load_case(path))
    c = np.linspace(0.1, 0.9, 162)
    np.save(tmp_path / "c.npy", c)
    np.testing.assert_array_equal(starting_surface(load_case(path)).initial["c"], c)


def test_a_case_becomes_the_laws_that_it_names():
    case = load_case(COUPLED)
    start = starting_surface(case)
    laws = flow_of(case, start.mesh, start.x).laws
    kinds = [type(law) for law in laws]
    assert kinds[:3] == [CahnHilliard, Mixing, HelfrichFlow] and Loads in kinds
    assert [kind.__name__ for kind in kinds[3:]] == ["NoDrift", "Loads", "MinimalDeformation"]
    equal = load_case(COUPLED.replace("[0.5, 0.8]", "0.5").replace("[0.0, 0.5]", "[0.0, 0.0]"))
    assert type(flow_of(equal, start.mesh, start.x).laws[2]) is WillmoreFlow
    rest = load_case(REST.replace("cahn-hilliard", "allen-cahn"))
    laws = flow_of(rest, start.mesh, start.x).laws
    assert [type(law) for law in laws] == [AllenCahn, Mixing] and laws[0].held_amount


def test_a_case_is_written_back_complete():
    case = load_case(COUPLED)
    again = load_case(case.to_toml())
    assert again == case
    assert again.phase.bending_modulus == (0.5, 0.8)


@pytest.mark.parametrize("name", ["rafts", "two_phase_vesicle", "demixing"])
def test_the_examples_are_sound(name):
    case = load_case(f"example:{name}")
    assert case.phase is not None and example_path(f"example:{name}").is_file()


def test_a_surface_at_rest_leaves_its_concentration(tmp_path):
    run = run_case(load_case(REST), tmp_path / "out")
    summary = json.loads((run.folder / "summary.json").read_text())
    phase = summary["phase"]
    names = ("amount", "mean", "smallest", "largest", "interface_length", "domains")
    names += ("energy_bending", "energy_gaussian", "energy_phase")
    assert set(names) == set(phase)
    assert phase["mean"] == pytest.approx(0.4, abs=1e-9)
    assert summary["energy"] == pytest.approx(phase["energy_phase"], rel=1e-12)
    with open(run.folder / "history.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {f"phase_{name}" for name in names} <= set(rows[0])
    energies = [float(row["energy"]) for row in rows]
    assert len(rows) == 5 and all(b < a for a, b in zip(energies, energies[1:], strict=False))
    assert (run.folder / "final.png").stat().st_size > 10_000
    state = run.solution.state
    with np.load(run.folder / "final.npz") as final:
        np.testing.assert_array_equal(final["c"], state.fields["c"])
        assert "mu" in final
    total = float(amount(run.solution.mesh, state.x, state.fields["c"]))
    assert total == pytest.approx(phase["amount"], rel=1e-12)


def test_an_equilibrium_takes_the_same_section(tmp_path):
    run = run_equilibrium(load_case(COUPLED, "equilibrium"), tmp_path / "out")
    summary = run.summary
    phase = summary["phase"]
    assert run.succeeded and summary["negative_directions"] == 0
    parts = phase["energy_bending"] + phase["energy_gaussian"] + phase["energy_phase"]
    assert summary["energy"] == pytest.approx(parts, rel=1e-12)
    assert phase["mean"] == pytest.approx(0.5, abs=2e-3)  # the functional has its own quadrature
    with np.load(run.folder / "final.npz") as final:
        assert final["c"].shape == (42,)
    assert "law, mobility" in summary["notes"][0]
    with pytest.raises(CaseError, match='must be "willmore"'):
        run_equilibrium(load_case(REST, "equilibrium"), tmp_path / "rest")


BRANCH = '[branch]\nparameter = "{}"\nstop = {}\n'


def test_a_branch_follows_a_parameter_of_the_phases(tmp_path):
    text = COUPLED + BRANCH.format("mean", 0.51)
    run = run_branch(load_case(text, "branch"), tmp_path / "out")
    assert run.succeeded and run.summary["parameter"] == "mean"
    with open(run.folder / "branch.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["mean"]) == pytest.approx(0.51, rel=1e-9)
    # dE = mu dM along the branch; every point has its own reference, with an error of 42 nodes.
    E, mu, mean = (
        np.array([float(row[n]) for row in rows])
        for n in ("total_energy", "chemical_potential", "mean")
    )
    work = run.points[0].parameters.area * np.trapezoid(mu, mean)
    assert E[-1] - E[0] == pytest.approx(float(work), rel=2e-2)


@pytest.mark.parametrize(
    "text, words",
    [
        (COUPLED + BRANCH.format("spontaneous_curvature", 1.0), "is for one phase"),
        (COUPLED + BRANCH.format("mean", 1.5), "> 0 and < 1"),
        (COUPLED + BRANCH.format("line_tension", -1.0), "> 0"),
        (
            COUPLED[: COUPLED.index("[phase]")]
            + COUPLED[COUPLED.index("[constraints]") :]
            + BRANCH.format("line_tension", 1.0),
            "is for two phases",
        ),
    ],
)
def test_what_is_no_parameter_of_the_branch_is_refused(tmp_path, text, words):
    with pytest.raises(CaseError, match=words):
        run_branch(load_case(text, "branch"), tmp_path / "out")


@pytest.mark.slow
def test_the_two_phase_vesicle_has_its_energy(tmp_path):
    """48.84456 κ by an axisymmetric solution; 642 nodes are within 7e-4."""
    case = load_case("example:two_phase_vesicle")
    run = run_case(case, tmp_path / "out")
    summary = run.summary
    assert summary["status"] == "stationary"
    assert summary["energy"] == pytest.approx(48.84456, rel=7e-4)
    assert summary["reduced_volume"] == pytest.approx(0.85, abs=1e-6)
    assert summary["phase"]["mean"] == pytest.approx(0.5, abs=1e-9)
    assert summary["phase"]["domains"] == 1
    energies = [record["energy"] for record in run.solution.records]
    assert len(energies) <= 40
    assert max(b / a - 1 for a, b in zip(energies, energies[1:], strict=False)) < 1e-5
    neck = summary["phase"]["interface_length"] / (2 * math.pi)
    assert neck == pytest.approx(0.64218, rel=1e-2)
    for record in run.solution.records:
        assert record["area"] == pytest.approx(run.solution.records[0]["area"], rel=1e-10)

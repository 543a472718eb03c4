"""Branches: they agree with single equilibria, pass folds, and end for a named reason."""

import numpy as np
import pytest

from jaxwillmore import equilibria


@pytest.fixture(scope="module")
def short(prolate):
    return equilibria.branch(prolate, "reduced_volume", stop=0.76, step0=0.02)


@pytest.mark.slow
def test_branch_ends_exactly_at_stop(short):
    assert short.succeeded and equilibria.name_of(short.result) == "end_reached"
    np.testing.assert_allclose(short.points[-1].reduced_volume, 0.76, rtol=1e-12)
    volumes = [row["reduced_volume"] for row in short.rows]
    assert all(b < a for a, b in zip(volumes[:-1], volumes[1:], strict=True))


@pytest.mark.slow
def test_slope_of_the_energy_along_the_branch_is_the_pressure(short):
    """dE/dv at fixed area is P dV/dv: the trapezoidal rule joins two points to third order."""
    rows = short.rows
    for a, b in zip(rows[:-1], rows[1:], strict=True):
        rise = b["bending_over_8pi_kappa"] - a["bending_over_8pi_kappa"]
        slope = (a["scaled_pressure"] + b["scaled_pressure"]) / 2 * (4 * np.pi / 3) / (8 * np.pi)
        # What is left is the change of discretisation error between reference surfaces.
        assert rise == pytest.approx(slope * (b["reduced_volume"] - a["reduced_volume"]), rel=2e-2)


@pytest.mark.slow
def test_table_has_a_line_per_point(short):
    lines = short.table().splitlines()
    assert lines[0].startswith("reduced_volume,bending_over_8pi_kappa")
    assert len(lines) == len(short.points) + 1


def test_a_branch_that_may_not_move_says_why(prolate):
    none = equilibria.branch(prolate, stop=0.7, max_points=0)
    assert equilibria.name_of(none.result) == "point_limit"
    assert len(none.points) == 1
    # Steps that cannot succeed: the first one is as large as it may not be.
    stuck = equilibria.branch(prolate, stop=0.3, step0=0.49, max_step=0.49, min_step=0.4)
    assert equilibria.name_of(stuck.result) == "step_too_small"
    with pytest.raises(RuntimeError, match="point_limit"):
        equilibria.branch(prolate, stop=0.7, max_points=0, throw=True)


def test_an_observer_may_end_a_branch(prolate):
    seen = []

    def observer(row, shape):
        seen.append(row["reduced_volume"])
        return len(seen) == 2

    found = equilibria.branch(prolate, stop=0.7, step0=0.02, observer=observer)
    assert equilibria.name_of(found.result) == "stopped" and not found.succeeded
    assert len(found.points) == len(seen) == 2


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"parameter": "pressure", "stop": 1.0}, "free volume"),
        ({"parameter": "length", "stop": 1.0}, "must be one of"),
        ({"stop": 1.5}, r"\(0, 1\)"),
        ({"stop": 1.0}, "less than 1.*the only shape of reduced volume 1"),
        ({"stop": float("nan")}, "finite"),
    ],
)
def test_branch_refuses(prolate, arguments, message):
    with pytest.raises(ValueError, match=message):
        equilibria.branch(prolate, **arguments)


@pytest.mark.slow
def test_pressure_branch_passes_the_fold_and_changes_stability_there(prolate):
    start = equilibria.equilibrium(
        prolate.mesh, prolate.x, bending_modulus=0.7, pressure=float(prolate.pressure)
    )
    stop = float(start.pressure) * 0.5
    found = equilibria.branch(start, "pressure", stop=stop, max_points=10)
    fold = found.events[0]
    assert fold.event == "fold" and tuple(fold.negative_directions) == (0, 1)
    # Beyond the fold the prolates lead to the sphere, which buckles at P R0³ = −12 κ.
    pressures = [row["scaled_pressure"] for row in found.rows]
    assert pressures[fold.point] == pytest.approx(-11.34, abs=0.04)
    assert pressures[-1] < max(pressures)


@pytest.mark.slow
def test_prolate_and_oblate_cross_near_0_651():
    energies = {}
    grid = np.linspace(0.64, 0.66, 3)
    for kind in ("prolate", "oblate"):
        mesh, x = equilibria.spheroid(0.66, kind, level=2)
        start = equilibria.equilibrium(mesh, x, reduced_volume=0.66, stability=False)
        energies[kind] = [
            float(start.bending_over_8pi_kappa),
            *(
                float(
                    equilibria.branch(start, stop=float(v), stability=False)
                    .points[-1]
                    .bending_over_8pi_kappa
                )
                for v in grid[1::-1]
            ),
        ]
    gap = np.array(energies["prolate"]) - np.array(energies["oblate"])
    crossing = np.roots(np.polyfit(grid[::-1], gap, 2))
    nearest = crossing[np.argmin(np.abs(crossing - 0.65))]
    assert nearest == pytest.approx(0.651, abs=1e-3)

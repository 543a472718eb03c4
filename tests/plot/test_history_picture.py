"""The picture of a history draws whatever columns there are."""

import math

import numpy as np
import pytest

from jaxwillmore.plot import PlotError, history_picture
from jaxwillmore.plot._history import after_rejections

pytest.importorskip("matplotlib")


def rows(n=60, **constant):
    out = []
    for step in range(n):
        t = 1e-3 * (1.15**step - 1)
        energy = 8 * math.pi + 20 * math.exp(-3 * t)
        row = {
            "step": step, "t": t, "dt": 1e-3 * 1.15**step, "energy": energy, "willmore": energy,
            "willmore_of_field": energy * 1.001, "area": 12.0, "volume": 3.0 + t,
            "reduced_volume": 0.9, "min_angle": 30.0, "max_angle": 100.0,
            "normal_length_defect": 1e-4, "normal_distance": 1e-3, "newton_iterations": 3,
            "krylov_iterations": 50, "rejected_steps": (step + 1) // 20,
        }  # fmt: skip
        out.append(row | constant)
    return out


def shape(path):
    from matplotlib import image

    return image.imread(path).shape[:2]


@pytest.mark.parametrize("reference", [None, {"8π": 8 * math.pi}])
def test_six_panels(tmp_path, reference):
    history_picture(tmp_path / "a.png", rows(), reference=reference, title="run", dpi=50.0)
    height, width = shape(tmp_path / "a.png")
    assert width == 625 and height > 450


def test_missing_columns_leave_out_panels(tmp_path):
    few = [{"t": r["t"], "energy": r["energy"], "dt": r["dt"]} for r in rows()]
    history_picture(tmp_path / "few.png", few, dpi=50.0)
    history_picture(tmp_path / "all.png", rows(), dpi=50.0)
    assert shape(tmp_path / "few.png")[0] < 0.5 * shape(tmp_path / "all.png")[0]


def test_a_surface_at_rest_needs_no_panels_of_its_geometry(tmp_path):
    phase = {"phase_mean": 0.4, "phase_smallest": 0.0, "phase_largest": 1.0}
    moving = [row | phase for row in rows()]
    still = [row | {"area": 1.0, "willmore": 20.0} for row in moving]
    history_picture(tmp_path / "moving.png", moving, dpi=50.0)
    history_picture(tmp_path / "still.png", still, dpi=50.0)
    assert shape(tmp_path / "still.png")[0] < 0.7 * shape(tmp_path / "moving.png")[0]


@pytest.mark.parametrize(
    "data",
    [
        rows(1),
        rows(2),
        rows(30, energy=math.nan, dt=0.0, min_angle=None),
        rows(30, normal_length_defect=0.0, willmore_of_field=None, t=0.0),
        rows(30, energy=np.float64(-1.0), willmore=0.0, area=0.0),
    ],
    ids=["one step", "two steps", "nan", "zeros", "negative"],
)
def test_degenerate_histories_are_drawn_without_a_warning(tmp_path, data):
    history_picture(tmp_path / "a.png", data, reference={"8π": 8 * math.pi}, dpi=40.0)
    assert shape(tmp_path / "a.png")[0] > 100


def test_nothing_to_draw_is_a_plot_error(tmp_path):
    with pytest.raises(PlotError, match="no steps"):
        history_picture(tmp_path / "a.png", [])
    with pytest.raises(PlotError, match="none of the columns"):
        history_picture(tmp_path / "a.png", [{"t": 0.0, "mass": 1.0}])
    with pytest.raises(PlotError, match="cannot write"):
        history_picture(tmp_path / "no" / "a.png", rows(3))
    assert not list(tmp_path.iterdir())


def test_only_the_steps_after_a_rejection_are_marked():
    """The count of a history is that of all attempts so far."""
    assert after_rejections(np.array([0.0, 0, 1, 1, 3, 3])).tolist() == [2, 4]
    assert after_rejections(np.array([2.0, 2, 2])).tolist() == [0]
    assert after_rejections(np.full(3, np.nan)).tolist() == []

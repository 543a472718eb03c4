"""Pictures of convergence studies."""

import pytest

from jaxwillmore.plot import PlotError, orders_picture

ROWS = [
    {"surface": s, "direction": d, "energy": e, "h": h, "error": c * h**4}
    for s in ("torus", "bumpy")
    for d in ("normal", "tangential")
    for c, e in ((1.0, "Willmore"), (0.0, "tension"))
    for h in (0.4, 0.2)
]


@pytest.mark.parametrize("panels", [("surface", "direction"), ("surface",)])
def test_a_study_becomes_a_picture(tmp_path, panels):
    path = tmp_path / "orders.png"
    orders_picture(path, ROWS, panels=panels, lines="energy", order=4.0, title="study")
    assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000


def test_a_study_without_errors_is_refused(tmp_path):
    with pytest.raises(PlotError, match="nothing to draw"):
        orders_picture(
            tmp_path / "a.png", ROWS[2:4], panels=("surface",), lines="energy", order=4.0
        )

"""Where fits start: bowls, families, and the list of several starts."""

import inspect
from typing import Any

import numpy as np
import pytest

from jaxwillmore.equilibria import equilibrium, spheroid
from jaxwillmore.fit import MatchIterate, match_shapes, name_of
from jaxwillmore.fit._match import _starts
from jaxwillmore.fit._starts import BOWL, bowl, kind_of
from jaxwillmore.fit._targets import target
from jaxwillmore.fit._unknowns import of_unit_size, unknowns
from jaxwillmore.surface import area, reduced_volume

HELD = {"scaled_spontaneous_curvature": 0.0, "scaled_pressure": 0.0}


@pytest.mark.parametrize("volume", [0.5, 0.62])
def test_a_bowl_has_its_volume_and_is_open_on_one_side(volume):
    mesh, x = bowl(volume, level=1)
    np.testing.assert_allclose(reduced_volume(mesh, x), volume, atol=1e-5)
    np.testing.assert_allclose(area(mesh, x), 4 * np.pi, rtol=1e-12)
    assert kind_of(mesh, x) == "stomatocyte"
    # Turned over it is the same.
    assert kind_of(mesh, x * np.array([[1.0, -1.0, -1.0]])) == "stomatocyte"


@pytest.mark.parametrize("kind", ["prolate", "oblate"])
def test_spheroids_are_told_from_bowls(kind):
    assert kind_of(*spheroid(0.6, kind, level=1)) == kind


def test_no_bowl_for_a_sphere():
    with pytest.raises(ValueError, match=r"in \(0.3, 0.85\); got 0.9"):
        bowl(0.9, level=1)


def labels(own, start, free=("reduced_volume",), bounds=None, resume=None):
    """Names of the starts for an oblate of a reduced volume, with their reduced volumes."""
    seen = target(*spheroid(own, "oblate", level=1))
    values = [HELD | {"reduced_volume": start}]
    layout = unknowns(free, (), {} if bounds is None else bounds, values)
    starts = _starts("several", values, (seen,), layout, resume)
    return {label: round(p[0]["reduced_volume"], 2) for label, _, p in starts}


def test_several_starts_are_those_that_the_target_asks_for():
    plain = {"prolate": 0.7, "oblate": 0.7}
    assert labels(0.7, 0.7) == plain
    own = {"prolate, own volume": 0.8, "oblate, own volume": 0.8}
    assert labels(0.8, 0.7) == plain | own
    assert labels(0.6, 0.6)[BOWL] == 0.6
    # A bowl at the volume of the target, or at the one that is held.
    assert labels(0.6, 0.7)[BOWL] == 0.6
    assert BOWL not in labels(0.6, 0.7, free=("scaled_spontaneous_curvature",))
    assert labels(0.7, 0.6, free=("scaled_spontaneous_curvature",)).keys() == {
        "prolate",
        "oblate",
        BOWL,
    }
    # Volumes follow a free pressure; out of bounds nothing starts; a resumed fit goes on.
    assert labels(0.6, 0.7, free=("scaled_pressure",)) == plain
    assert labels(0.6, 0.7, bounds={"reduced_volume": (0.65, 0.9)}) == plain
    assert labels(0.6, 0.7, resume=MatchIterate((), ())) == {"prolate": 0.7}


@pytest.mark.slow
def test_a_stomatocyte_is_found_among_several_starts():
    """An equilibrium on its own mesh, v = 0.6: nearer than what prolates and oblates end as."""
    mesh, x = bowl(0.6, level=1)
    held: dict[str, Any] = {"area": 4 * np.pi, "reduced_volume": 0.6}
    made = equilibrium(mesh, x, stability=False, **held)
    fit = match_shapes(
        [(mesh, made.x)],
        free=("reduced_volume",),
        kind="several",
        level=1,
        tolerance=1e-4,
        max_steps=30,
        throw=False,
    )
    assert min(fit.stats["starts"], key=fit.stats["starts"].get) == BOWL
    assert fit.succeeded, name_of(fit.result)
    assert kind_of(fit.shapes[0].mesh, fit.shapes[0].x) == BOWL
    np.testing.assert_allclose(fit.shapes[0].parameters["reduced_volume"], 0.6, atol=2e-3)
    assert fit.rms < 0.02 and fit.verdict.evidence.get("next", 10.0) > 3


@pytest.mark.parametrize("by_pressure", [False, True])
def test_a_model_is_asked_for_by_the_names_of_an_equilibrium(by_pressure):
    """In units of its own R0 and κ a scaled number is the number itself."""
    p = {"reduced_volume": 0.8, "scaled_spontaneous_curvature": -1.2, "scaled_pressure": -9.0}
    held = of_unit_size(p, 1.5, by_pressure)
    assert set(held) <= set(inspect.signature(equilibrium).parameters)
    assert held["spontaneous_curvature"] == -1.2 * 1.5
    assert held["pressure" if by_pressure else "reduced_volume"] == (-9.0 if by_pressure else 0.8)
    assert len(held) == 3

"""A case in other units is the same case, and what no surface can be is refused in them."""

import math

import pytest

from jaxwillmore.cases import CaseError, load_case
from jaxwillmore.runs import run_equilibrium

CASE = """
[surface]
shape = "ellipsoid"
semi_axes = [{R}, {R}, {long}]
level = 0
[energy]
bending_modulus = {b}
[constraints]
area = "initial"
reduced_volume = 0.8
[output]
picture = false
"""


@pytest.mark.slow
def test_an_equilibrium_in_metres_and_joules_is_the_one_in_units_of_one(tmp_path):
    found = []
    for R, b in ((1.0, 0.5), (1e-6, 5e-20)):
        case = load_case(CASE.format(R=R, long=2 * R, b=b), "equilibrium")
        found.append(run_equilibrium(case, tmp_path / str(R)).summary)
    one, si = found
    assert one["bending_over_8pi_kappa"] == pytest.approx(si["bending_over_8pi_kappa"], rel=1e-8)
    for name, unit in (("tension", 1e-19 / 1e-12), ("pressure", 1e-19 / 1e-18)):
        assert si["multipliers"][name] == pytest.approx(one["multipliers"][name] * unit, rel=1e-6)


def test_a_volume_that_the_area_cannot_enclose_is_refused_with_the_largest_one(tmp_path):
    text = '[surface]\nshape = "ellipsoid"\nlevel = 0\n[constraints]\narea = 12.566\nvolume = 5.0\n'
    largest = 12.566**1.5 / (6 * math.sqrt(math.pi))
    with pytest.raises(CaseError, match=f"{largest:.10g}"):
        run_equilibrium(load_case(text, "equilibrium"), tmp_path / "out")

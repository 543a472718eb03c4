"""A case in other units is the same case, and what no surface can be is refused in them."""

import ast
import dataclasses
import math
import pathlib
import re

import pytest

import jaxwillmore as jw
from jaxwillmore import cases, fit
from jaxwillmore.cases import QUANTITIES, CaseError, load_case, load_fit
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


# One table of names, symbols and units; everything that has a name keeps to it.

SECTIONS = {
    kind.__name__: kind
    for kind in vars(cases).values()
    if isinstance(kind, type) and hasattr(kind, "name") and dataclasses.is_dataclass(kind)
}
# Numbers of a computation, which are no quantities of a membrane.
OF_THE_METHOD = {
    *("rtol", "tolerance", "stop_when_stationary", "consistency", "amplitude"),
    *("checkpoint_minutes", "stop", "step0", "max_step", "min_step"),
    *("reduced_volume_bounds", "scaled_spontaneous_curvature_bounds"),
    "spontaneous_curvature_bounds",
}


@pytest.mark.parametrize("kind", SECTIONS.values(), ids=SECTIONS)
def test_every_number_of_a_case_is_a_quantity_of_the_table(kind):
    with_numbers = {key for key, hint in kind.__annotations__.items() if "float" in str(hint)}
    assert with_numbers <= set(QUANTITIES) | OF_THE_METHOD


def test_a_case_file_writes_symbols_and_units():
    text = load_case("[surface]\nshape = 'sphere'\n", "equilibrium").to_toml()
    for words in ("# b_b (energy): in", "# H₀ (1/length): ", "# σ (energy/length²): "):
        assert words in text
    assert (
        "scaled_spontaneous_curvature = 0.0  # H₀R₀: "
        in load_fit({"target": {"file": "a.ply"}}).to_toml()
    )


def test_what_a_fit_finds_is_in_the_table():
    named = {*fit.SHAPE_PARAMETERS, *fit.FORCE_PARAMETERS, *cases.FLOW_PARAMETERS}
    assert named <= set(QUANTITIES)


BULLET = re.compile(r"^ +- ((?:`\w+`(?:, )?)+): (.*(?:\n +[^-\s].*)*)", re.MULTILINE)
UNIT = re.compile(r"\$, ((?:1|energy|amount|length|time)\b[^\s,;:]*)")


def described_quantities():
    """What docstrings say of arguments and attributes that are in the table."""
    for path in sorted(pathlib.Path(jw.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                for names, text in BULLET.findall(ast.get_docstring(node, clean=False) or ""):
                    known = [n for n in re.findall(r"\w+", names) if n in QUANTITIES]
                    if known and len(known) == len(re.findall(r"\w+", names)):
                        yield f"{path.parent.name}.{node.name}", known, text


DESCRIBED = list(described_quantities())


def test_docstrings_describe_quantities():
    assert len(DESCRIBED) > 30
    assert sum(bool(UNIT.search(text)) for _, _, text in DESCRIBED) > 15


@pytest.mark.parametrize("where, names, text", DESCRIBED)
def test_docstrings_keep_to_the_units_of_the_table(where, names, text):
    units = {QUANTITIES[name].unit for name in names}
    for unit in (word.rstrip(".") for word in UNIT.findall(text)):
        assert unit in units, f"{where}: {names} are in {units}, not in {unit}"
    for name in names:
        if not name.startswith("scaled_") and QUANTITIES[name].unit:
            assert "R_0" not in text or name == "radius", f"{where}: {name} without units"

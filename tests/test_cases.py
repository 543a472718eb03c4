"""Case files: what is read is what is meant, what is wrong is named, what is written reads back."""

# pyright: reportOptionalMemberAccess=false

import dataclasses
import math
import tomllib
from typing import Any

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

from jaxwillmore.cases import (
    Case,
    CaseError,
    EnergyCase,
    FlowCase,
    OsmoticCase,
    OutputCase,
    SurfaceCase,
    TimeCase,
    example_names,
    example_path,
    load_case,
)
from jaxwillmore.cases._toml import emit

SHORT = {"surface": {"shape": "torus"}, "time": {"t1": 1.0}}


def changed(section, **keys):
    """A short valid case with some keys of one section changed."""
    return {**SHORT, section: {**SHORT.get(section, {}), **keys}}


# 1. Reading.


def test_the_full_case_file_is_read_key_by_key():
    case = load_case("""
        [surface]
        shape = "red_cell"
        level = 2
        degree = 2
        [energy]
        bending_modulus = 0.5
        spontaneous_curvature = 0.0
        [flow]
        kind = "willmore"
        scheme = "implicit"
        bdf_order = 2
        [time]
        t1 = 5.0
        dt0 = 1e-3
        rtol = 1e-3
        stop_when_stationary = 1e-6
        [output]
        every = 0.1
    """)
    assert (case.surface.shape, case.surface.level, case.surface.degree) == ("red_cell", 2, 2)
    assert (case.energy.bending_modulus, case.energy.spontaneous_curvature) == (0.5, 0.0)
    assert (case.flow.kind, case.flow.scheme, case.flow.bdf_order) == ("willmore", "implicit", 2)
    assert (case.time.t0, case.time.t1, case.time.dt0) == (0.0, 5.0, 1e-3)
    assert (case.time.rtol, case.time.stop_when_stationary) == (1e-3, 1e-6)
    assert case.output.every == 0.1


def test_a_case_needs_only_a_surface_and_an_end():
    case = load_case(SHORT)
    assert case == Case(surface=SurfaceCase(shape="torus"), time=TimeCase(t1=1.0))
    assert case.energy == EnergyCase(bending_modulus=0.5, spontaneous_curvature=0.0)
    assert case.flow == FlowCase(bdf_order=2, consistency=6.0)
    assert case.output == OutputCase(every=1 / 50, frames=True, picture=True)
    assert case.surface.parameters["minor_radius"] == 0.4


def test_whole_numbers_are_fine_where_numbers_are_meant():
    case = load_case(changed("surface", shape="ellipsoid", semi_axes=[1, 1, 2]))
    assert case.surface.parameters["semi_axes"] == (1.0, 1.0, 2.0)
    assert isinstance(load_case(changed("time", t1=3)).time.t1, float)
    assert Case(surface=case.surface, time=TimeCase(t1=np.float64(2.0))).time.t1 == 2.0


def test_level_keeps_the_triangles_of_a_file_by_default():
    assert SurfaceCase(file="cell.ply").level == 0
    assert SurfaceCase(shape="sphere").level == 2


def test_a_mesh_is_found_beside_its_case_file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text("[surface]\nfile = 'meshes/../cell.ply'\n[time]\nt1 = 1.0\n", encoding="utf-8")
    assert load_case(path).surface.file == str(tmp_path / "cell.ply")
    assert load_case(str(path)) == load_case(path)


def test_windows_line_ends_and_byte_order_mark_are_read(tmp_path):
    path = tmp_path / "case.toml"
    path.write_bytes(b"\xef\xbb\xbf[surface]\r\nshape = 'sphere'\r\n[time]\r\nt1 = 1.0\r\n")
    assert load_case(path).surface.shape == "sphere"


COMMANDS: dict[str, Any] = {"vesicle": "equilibrium", "discocytes": "branch"}


@pytest.mark.parametrize("name", example_names())
def test_examples_are_valid_cases(name):
    case = load_case(f"example:{name}", COMMANDS.get(name, "run"))
    assert load_case(case.to_toml(), COMMANDS.get(name, "run")) == case
    if case.surface.file is not None:
        assert example_path(case.surface.file).is_file()


# 2. Writing.


@hypothesis.settings(deadline=None, max_examples=50)
@hypothesis.given(
    surface=st.one_of(
        st.fixed_dictionaries(
            {
                "shape": st.just("ellipsoid"),
                "level": st.integers(0, 7),
                "degree": st.integers(1, 4),
                "parameters": st.fixed_dictionaries(
                    {}, optional={"semi_axes": st.tuples(*[st.floats(1e-300, 1e300)] * 3)}
                ),
            }
        ),
        st.fixed_dictionaries(
            {
                "file": st.text().filter(lambda s: "\0" not in s).map("example:".__add__),
                "merge_tolerance": st.none() | st.floats(0, 1e300),
                "fix_orientation": st.booleans(),
            }
        ),
    ),
    modulus=st.floats(0, 1e300, exclude_min=True),
    curvature=st.floats(allow_nan=False, allow_infinity=False),
    t0=st.floats(-1e3, 1e3),
    length=st.floats(1e-3, 1e6),
    fraction=st.floats(1e-3, 1),
    frames=st.booleans(),
)
def test_what_is_written_reads_back_exactly(
    surface, modulus, curvature, t0, length, fraction, frames
):
    case = Case(
        surface=SurfaceCase(**surface),
        energy=EnergyCase(bending_modulus=modulus, spontaneous_curvature=curvature),
        time=TimeCase(t0=t0, t1=t0 + length, dt0=fraction * length * 0.999),
        output=OutputCase(every=fraction * length * 0.999, frames=frames),
    )
    assert load_case(case.to_toml()) == case


def test_a_written_case_is_complete():
    tables = tomllib.loads(load_case(SHORT).to_toml())
    for name, kind in {"energy": EnergyCase, "flow": FlowCase, "time": TimeCase}.items():
        # Sections below a section are tables of their own, and absent here.
        keys = {field.name for field in dataclasses.fields(kind) if "rule" in field.metadata}
        assert set(tables[name]) == keys - {"dt0"}  # follows from the surface unless it is given
    assert {"shape", "level", "degree", "major_radius", "minor_radius"} <= set(tables["surface"])
    checks = {"self_intersection": False, "fatal_warnings": False, "checkpoint_minutes": 1.0}
    assert tables["output"] == {"every": 1 / 50, "frames": True, "picture": True, **checks}


@hypothesis.given(
    st.recursive(
        st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
        lambda values: st.lists(values, max_size=3),
        max_leaves=5,
    )
)
def test_every_value_of_toml_survives_writing(value):
    assert tomllib.loads(emit({"table": [("key", value, "a comment")]})) == {
        "table": {"key": value}
    }


def test_writing_refuses_what_toml_cannot_say():
    with pytest.raises(TypeError, match="complex"):
        emit({"table": [("key", 1j, "")]})


def test_energies_of_the_whole_surface_are_sections_of_their_own():
    case = load_case("""
        [surface]
        shape = "red_cell"  # which has a `thickness` too
        thickness = 0.9
        [energy]
        gaussian_modulus = -0.3
        [energy.osmotic]
        solute_amount = 2
        ambient_concentration = 1.5
        [energy.area_difference]
        nonlocal_modulus = 1.0
        preferred_difference = -0.1
        thickness = 0.01
        [energy.area_penalty]
        stretching_modulus = 3.0
        [energy.volume_penalty]
        strength = 4.0
        preferred_volume = 5.0
        [constraints]
        area = "initial"
        reduced_volume = 0.7
        ramp = 0.5
        [time]
        t1 = 1.0
    """)
    energy = case.energy
    assert energy.osmotic == OsmoticCase(solute_amount=2.0, ambient_concentration=1.5)
    assert energy.osmotic.temperature == 298.15
    assert energy.area_difference.thickness == 0.01
    assert case.surface.parameters["thickness"] == 0.9
    assert energy.area_penalty.preferred_area == "initial"
    assert energy.volume_penalty.preferred_volume == 5.0
    assert load_case(case.to_toml()) == case


def test_a_written_case_names_the_sections_it_does_not_have():
    text = load_case(SHORT).to_toml()
    assert "# [energy.osmotic] is not set" in text and "solute_amount" in text


def test_what_a_case_needs_depends_on_its_command():
    surface = {"surface": {"shape": "torus"}}
    assert load_case(surface, "equilibrium").time is None
    case = load_case({**surface, "branch": {"stop": 0.7}}, "branch")
    assert case.branch.parameter == "reduced_volume" and case.branch.max_points == 100
    assert load_case(case.to_toml(), "branch") == case
    with pytest.raises(CaseError, match=r"\[branch\] is missing"):
        load_case(surface, "branch")


# 3. Refusing.

WRONG = [
    # section, keys, words the error must contain
    ("energy", {"bending_modulus": 0.0}, ["> 0", "got 0.0"]),
    ("energy", {"bending_modulus": -1}, ["> 0", "got -1"]),
    ("energy", {"bending_modulus": math.nan}, ["finite", "nan"]),
    ("energy", {"bending_modulus": math.inf}, ["finite", "inf"]),
    ("energy", {"bending_modulus": "0.5"}, ["a finite number", "without quotes"]),
    ("energy", {"bending_modulus": "0,5"}, ["decimal point"]),
    ("energy", {"bending_modulus": [0.5]}, ["a finite number", "[0.5]"]),
    ("energy", {"bending_modulus": True}, ["a finite number", "got true"]),
    ("energy", {"bending_modulus": 10**400}, ["a finite number"]),
    ("energy", {"spontaneous_curvature": math.nan}, ["finite", "nan"]),
    ("energy", {"bending_modolus": 1.0}, ["unknown", "`bending_modulus`"]),
    ("energy", {"osmotc": {"solute_amount": 1.0}}, ["unknown", "`osmotic`"]),
    ("energy", {"temperature": 300.0}, ["unknown", "[energy.osmotic]"]),
    ("constraints", {"area": -1.0}, ["> 0", "got -1"]),
    ("constraints", {"area": "inital"}, ['"initial"', "'inital'"]),
    ("constraints", {"area": 1.0, "reduced_volume": 1.1}, ["<= 1", "got 1.1"]),
    ("constraints", {"area": 1.0, "reduced_volume": 0.0}, ["> 0 and <= 1", "got 0.0"]),
    ("constraints", {"area": 1.0, "volume": 0.1}, ["<= 0.0940315", "sphere", "got 0.1"]),
    ("constraints", {"volume": 1.0, "area": 9.0, "reduced_volume": 0.9}, ["either", "not both"]),
    ("constraints", {"reduced_volume": 0.9}, ["held area"]),
    ("constraints", {"area": 1.0, "volume": "initial", "ramp": 1.0}, ["a number", "`volume`"]),
    ("constraints", {"volum": 1.0}, ["unknown", "`volume`"]),
    ("branch", {"stop": 0.7, "parameter": "volume"}, ['"reduced_volume"']),
    ("branch", {"stop": 1.5}, ["> 0 and <= 1", "got 1.5"]),
    ("branch", {"stop": 0.7, "max_point": 3}, ["unknown", "`max_points`"]),
    ("flow", {"kind": "wilmore"}, ['"willmore"', "`willmore`"]),
    ("flow", {"scheme": "linear-implicit"}, ["`linearly-implicit`"]),
    ("flow", {"scheme": 1}, ['"implicit"', "got 1"]),
    ("flow", {"bdf_order": 0}, ["from 1 to 5", "got 0"]),
    ("flow", {"bdf_order": 6}, ["from 1 to 5", "got 6"]),
    ("flow", {"bdf_order": 2.0}, ["Write 2 without"]),
    ("flow", {"bdf_order": 2.5}, ["a whole number", "2.5"]),
    ("flow", {"consistency": -1.0}, [">= 0"]),
    ("flow", {"rtol": 1e-3}, ["unknown", "[time]"]),
    ("time", {"t1": math.nan}, ["finite", "nan"]),
    ("time", {"t1": "5"}, ["without quotes"]),
    ("time", {"t1": -1.0}, ["> t0 = 0", "got -1"]),
    ("time", {"t0": 1.0, "t1": 1.0}, ["> t0 = 1", "got 1"]),
    ("time", {"dt0": 0.0}, ["> 0", "got 0"]),
    ("time", {"dt0": -1e-3}, ["> 0"]),
    ("time", {"dt0": math.nan}, ["finite"]),
    ("time", {"dt0": 2.0}, ["<= t1 - t0 = 1", "got 2"]),
    ("time", {"rtol": 0.0}, ["> 0 and < 1"]),
    ("time", {"rtol": 1.0}, ["> 0 and < 1"]),
    ("time", {"max_steps": 0}, [">= 1", "got 0"]),
    ("time", {"max_steps": 1e4}, ["Write 10000 without"]),
    ("time", {"stop_when_stationary": -1e-6}, [">= 0"]),
    ("time", {"max_step": 5}, ["unknown", "`max_steps`"]),
    ("output", {"every": 0.0}, ["> 0"]),
    ("output", {"every": math.nan}, ["finite"]),
    ("output", {"every": 2.0}, ["t1 - t0 = 1", "got 2"]),
    ("output", {"every": 1e-9}, ["from 1e-05"]),
    ("output", {"frames": 1}, ["true or false", "got 1"]),
    ("output", {"picture": "true"}, ["without quotes"]),
    ("mesh", {"remesh_when": 60.0}, ["an angle > 0 and < 45", "got 60"]),
    ("mesh", {"remesh_when": -1}, ["> 0"]),
    ("mesh", {"remesh_size": "fine"}, ["uniform", "curvature"]),
    ("mesh", {"remesh_every": 0}, [">= 1"]),
    ("mesh", {"remesh_wen": 15}, ["unknown", "`remesh_when`"]),
    ("surface", {"shape": "thorus"}, ["thorus", "`torus`", "ellipsoid"]),
    ("surface", {"shape": 3}, ["text in quotes", "got 3"]),
    ("surface", {"level": -1}, ["from 0 to 7"]),
    ("surface", {"level": 8}, ["from 0 to 7"]),
    ("surface", {"degree": 0}, ["from 1 to 4"]),
    ("surface", {"degree": 5}, ["from 1 to 4"]),
    ("surface", {"degree": "2"}, ["without quotes"]),
    ("surface", {"minor_radios": 0.4}, ["unknown", "`minor_radius`"]),
    ("surface", {"semi_axes": [1, 1, 2]}, ["unknown"]),
    ("surface", {"minor_radius": math.nan}, ["finite"]),
    ("surface", {"n_major": 2.5}, ["whole number"]),
    ("surface", {"file": "cell.ply"}, ["either `shape` or `file`", "both"]),
    ("surface", {"merge_tolerance": 1e-9}, ["from a file"]),
    ("surface", {"fix_orientation": True}, ["from a file"]),
]


@pytest.mark.parametrize(
    "section, keys, words", WRONG, ids=lambda value: str(value)[:40] if value else None
)
def test_a_wrong_key_is_named_with_what_is_allowed(tmp_path, section, keys, words):
    with pytest.raises(CaseError) as caught:
        load_case(changed(section, **keys))
    error, message = caught.value, str(caught.value)
    assert f"[{section}]" in message and error.section == section
    if "either" not in message:
        assert error.key in keys and str(error.key) in message
    for word in words:
        assert word in message, message
    assert error.in_file("my.toml").args[0] == f"my.toml: {message}"


WRONG_ENERGIES = [
    ("osmotic", {"solute_amount": 0, "ambient_concentration": 1.0}, ["solute_amount", "> 0"]),
    ("osmotic", {"solute_amount": 1.0, "ambient_concentration": 0.0}, ["ambient", "> 0"]),
    ("osmotic", {"solute_amount": 1.0}, ["ambient_concentration", "missing"]),
    ("osmotic", {"solut_amount": 1.0}, ["unknown", "`solute_amount`"]),
    ("osmotic", 3.0, ["table", "[energy.osmotic]"]),
    ("area_penalty", {"stretching_modulus": -1.0}, ["stretching_modulus", "> 0"]),
    ("volume_penalty", {"strength": 1.0, "preferred_volume": 0.0}, ["preferred_volume", "> 0"]),
    (
        "area_difference",
        {"nonlocal_modulus": -1.0, "preferred_difference": 0.0, "thickness": 1.0},
        ["nonlocal_modulus", "> 0"],
    ),
]


@pytest.mark.parametrize("name, table, words", WRONG_ENERGIES)
def test_a_wrong_energy_is_named_with_its_section(name, table, words):
    with pytest.raises(CaseError) as caught:
        load_case(changed("energy", **{name: table}))
    for word in [f"[energy.{name}]", *words]:
        assert word in str(caught.value), str(caught.value)


def test_shapes_check_the_number_of_values():
    for axes in ([1, 2], [1, 2, 3, 4], 2.0, [1, 2, "3"], [1, 2, math.nan]):
        with pytest.raises(CaseError, match="a list of 3 finite numbers"):
            load_case(changed("surface", shape="ellipsoid", semi_axes=axes))


@pytest.mark.parametrize(
    "text, words",
    [
        ("[surface\n", ["not valid TOML", "line 1"]),
        ("[surface]\nshape = 'torus'\n", ["[time]", "missing"]),
        ("[time]\nt1 = 1.0\n", ["[surface]", "missing"]),
        ("[surface]\nshape = 'torus'\n[time]\n", ["[time] t1", "missing", "finite number"]),
        ("[surface]\n[time]\nt1 = 1.0\n", ["either `shape` or `file`", "neither"]),
        ("surface = 'torus'\n[time]\nt1 = 1.0\n", ["[surface]", "table"]),
        ("[[surface]]\nshape = 'torus'\n[time]\nt1 = 1.0\n", ["[surface]", "table"]),
        ("t1 = 1.0\n[surface]\nshape = 'torus'\n", ["`t1`", "belongs to [time]"]),
        ("[surfaces]\nshape = 'torus'\n[time]\nt1 = 1\n", ["unknown section", "`surface`"]),
        ("[surface]\nfile = 'a.ply'\nradius = 1\n[time]\nt1 = 1\n", ["radius", "unknown"]),
        ("[surface]\nfile = ''\n[time]\nt1 = 1\n", ["file", "text in quotes"]),
        ("[surface]\nshape = 'torus'\n[time]\nt1 = 1979-05-27\n", ["a finite number"]),
        ("[surface]\nshape = 'torus'\n[time]\nt1 = 1\nt1 = 2\n", ["not valid TOML"]),
        ("[a]\nx = " + "[" * 5000 + "\n", ["not valid TOML"]),
    ],
    ids=lambda value: value[:30] if isinstance(value, str) else None,
)
def test_a_wrong_file_is_named_with_what_is_missing(tmp_path, text, words):
    path = tmp_path / "wrong.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CaseError) as caught:
        load_case(path)
    for word in ["wrong.toml", *words]:
        assert word in str(caught.value), str(caught.value)
    assert isinstance(caught.value, ValueError)


def test_what_is_no_case_file_is_refused(tmp_path):
    (tmp_path / "latin.toml").write_bytes("# Übung\n".encode("latin-1"))
    (tmp_path / "large.toml").write_bytes(b"#" * (2**20 + 1))
    for source, words in {
        str(tmp_path / "none.toml"): "No such file",
        str(tmp_path): "cannot be read",
        str(tmp_path / "latin.toml"): "UTF-8",
        str(tmp_path / "large.toml"): "larger than",
        "example:thorus": "`torus`",
        "bad\0name": "cannot be read",
    }.items():
        with pytest.raises(CaseError, match=words):
            load_case(source)


def test_sections_cannot_be_swapped():
    with pytest.raises(CaseError, match="TimeCase"):
        Case(surface=SurfaceCase(shape="torus"), time=FlowCase())  # pyright: ignore


def test_what_is_not_set_is_mentioned():
    text = load_case(SHORT).to_toml()
    assert "# dt0 is not set" in text and "# n_major is not set" in text


@hypothesis.settings(deadline=None, max_examples=100)
@hypothesis.given(st.text() | st.binary())
def test_any_content_is_a_case_or_a_case_error(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.toml"
    data = content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass")
    path.write_bytes(data)
    with pytest.raises(CaseError, match="any.toml"):
        load_case(path)

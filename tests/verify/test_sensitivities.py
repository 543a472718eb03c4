"""Derivatives of every output by every parameter, of runs and of equilibria."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import equilibria, verify
from jaxwillmore.energies import CanhamHelfrich, OsmoticPressure
from jaxwillmore.fem import integrate
from jaxwillmore.mesh import ellipsoid

# 1. The test itself, on a map whose derivatives are known.


def toy(p):
    return {"square": p["a"] ** 2 * p["b"], "sine": jnp.sin(p["a"]), "line": 3.0 * p["b"]}


TOY = verify.Sensitivity(
    "toy", toy, {"a": jnp.asarray(0.7), "b": jnp.asarray(2.0)}, {"a": 0.01, "b": 0.01}
)


def test_a_right_derivative_has_slope_two():
    rows = {(row["output"], row["parameter"]): row for row in verify.sensitivity_rows(TOY)}
    assert len(rows) == 6
    assert rows["square", "a"]["derivative"] == pytest.approx(2.8, rel=1e-14)
    assert rows["sine", "a"]["derivative"] == pytest.approx(math.cos(0.7), rel=1e-14)
    for pair in (("square", "a"), ("sine", "a")):
        assert abs(rows[pair]["slope"] - 2) < 0.05
    for pair in (("square", "b"), ("line", "a"), ("line", "b"), ("sine", "b")):
        assert math.isnan(rows[pair]["slope"])  # linear: nothing remains
    assert all(row["modes"] < 1e-13 for row in rows.values())


def test_a_wrong_derivative_has_slope_one():
    """A map with a constant that autodiff cannot see."""

    def wrong(p):
        frozen = jnp.asarray(p["a"] ** 2)
        return {"y": toy(p)["sine"] + 1e-3 * jnp.round(frozen * 1e6) / 1e6}

    study = TOY._replace(map=wrong)
    row = next(r for r in verify.sensitivity_rows(study) if r["parameter"] == "a")
    assert row["slope"] < 1.95


# 2. Runs and equilibria.


def assert_derivatives(rows, count, outputs):
    """Slope 2 ± 0.05 for every pair, forward and reverse equal to 1e-10."""
    assert len(rows) == count
    for row in rows:
        assert row["modes"] < 1e-10, row
        assert math.isnan(row["slope"]) or abs(row["slope"] - 2) < 0.05, row
    curved = [row for row in rows if not math.isnan(row["slope"])]
    assert {row["output"] for row in curved} >= outputs


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["loaded", "held", "fields"])
def test_sensitivities_of_a_run(kind):
    mesh, n = verify.rough_sphere(0, 2)
    x = n * jnp.array([[1.0, 1.15, 1.35]])
    study = verify.run_sensitivity(mesh, x, 2, kind=kind)
    outputs = {"Willmore energy", "int H^3", "inertia", "harmonics", "distances", "profile"}
    outputs |= {"energy", "tension", "pressure"} if kind == "held" else {"energy"}
    rows = verify.sensitivity_rows(study)
    assert_derivatives(
        rows, {"loaded": 11, "held": 13, "fields": 11}[kind] * len(study.at), outputs
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["run", "equilibrium"])
def test_sensitivities_of_two_phases(kind):
    """By tension, width, moduli of one phase, mobility, the start or what is held."""
    if kind == "run":
        mesh, n = verify.rough_sphere(0, 2)
        study = verify.two_phase_run_sensitivity(mesh, n * jnp.array([[1.0, 1.15, 1.35]]))
        names = {"lambda", "width", "b_b", "H0", "b_k", "mobility", "c", "tau", "shape"}
    else:
        mesh, x = ellipsoid((0.712, 0.712, 1.677), 0, degree=2)
        study = verify.two_phase_sensitivity(mesh, x)
        names = {"lambda", "width", "b_b", "H0", "b_k", "reduced_volume", "mean"}
    assert set(study.at) == names
    # Of the other outputs some hardly depend on a parameter, and what is left is rounding.
    outputs = {"energy", "tension", "pressure", "harmonics", "int c^2", "int c^3"}
    rows = [row for row in verify.sensitivity_rows(study) if row["output"] in outputs]
    assert_derivatives(rows, len(outputs) * len(names), outputs)


def test_an_unknown_kind_of_run_is_refused():
    with pytest.raises(ValueError, match="'fields'"):
        verify.run_sensitivity(*verify.rough_sphere(0, 2), kind="free")


@pytest.fixture(scope="module")
def small():
    """A prolate of 42 nodes in units that are not one."""
    mesh, x = equilibria.spheroid(0.8, "prolate", level=0)
    return equilibria.equilibrium(
        mesh, 3.0 * x, reduced_volume=0.8, bending_modulus=0.7, stability=False
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["held", "loaded", "osmosis", "branch"])
def test_sensitivities_of_an_equilibrium(small, kind):
    shape = small
    if kind == "osmosis":
        n = float(small.parameters.volume) * (5.0 + float(small.pressure))
        energy = CanhamHelfrich(0.7) + OsmoticPressure(n, 5.0, 1.0, 1.0)
        shape = equilibria.equilibrium(small.mesh, small.x, energy, stability=False)
    if kind == "branch":
        along = equilibria.branch(small, stop=0.78, step0=0.01, stability=False)
        shape = along.points[1]
    study = verify.equilibrium_sensitivity(shape, held=kind != "loaded")
    rows = verify.sensitivity_rows(study)
    parameters, outputs = {"held": (4, 13), "branch": (4, 13), "osmosis": (7, 14)}.get(
        kind, (4, 11)
    )
    assert_derivatives(rows, parameters * outputs, {"int H^3", "distances", "profile"})
    if kind in ("held", "branch"):
        assert_envelope(shape, rows)


def assert_envelope(shape, rows):
    """dE*/dH0 = −∫y·ν and dE*/dv = P dV/dv, to 1e-6; the multipliers know the derivatives."""
    slope = {r["parameter"]: r["derivative"] for r in rows if r["output"] == "bending energy"}
    flux = integrate(
        shape.mesh,
        shape.x,
        lambda point, f: jnp.sum(f.Y.value * point.normal),
        {"Y": shape.Y},
        quadrature_degree=6,
    )
    A = shape.parameters.area
    np.testing.assert_allclose(slope["H0"], -flux, rtol=1e-6)
    by_volume = shape.pressure * A**1.5 / (6 * np.sqrt(np.pi))
    np.testing.assert_allclose(slope["reduced_volume"], by_volume, rtol=1e-6)
    # At a held reduced volume the volume grows with the area, too.
    by_area = -shape.tension + 1.5 * shape.pressure * shape.parameters.volume / A
    np.testing.assert_allclose(slope["area"], by_area, atol=1e-6 * abs(float(shape.tension)))

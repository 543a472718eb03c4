"""Forces of the whole surface: exact constraints, and spheres on their exact radius law."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxwillmore as jw
from jaxwillmore.energies import (
    AreaDifference,
    AreaPenalty,
    ExternalPotential,
    OsmoticPressure,
    Pressure,
    SurfaceTension,
)
from jaxwillmore.fem import Jet, point
from jaxwillmore.flows import Loads, MinimalDeformation, System, WillmoreFlow, as_system

from .systems import whole

FOUR_PI = 4 * np.pi


@pytest.fixture(scope="module")
def ellipsoid():
    return jw.mesh.ellipsoid(semi_axes=(1.0, 1.0, 1.4), level=1, degree=2)


def test_area_and_volume_are_held_to_rounding(ellipsoid):
    mesh, x = ellipsoid
    A0, V0 = jw.surface.area(mesh, x), jw.surface.volume(mesh, x)
    flow = System(WillmoreFlow(), Loads(area=A0, volume=V0))
    run = jw.evolve.evolve(flow, mesh, x, t1=1.0, max_steps=4, throw=False)
    assert len(run.records) == 4
    for record in run.records:
        np.testing.assert_allclose(record["area"], A0, rtol=1e-11)
        np.testing.assert_allclose(record["volume"], V0, rtol=1e-11)
    energies = [record["energy"] for record in run.records]
    assert np.all(np.diff(energies) < 0), energies
    assert float(jnp.max(jnp.abs(run.state.x - x))) > 1e-3  # it did move


def test_the_scale_of_the_energy_adds_the_sizes_of_its_terms(ellipsoid):
    mesh, x = ellipsoid
    A, V = float(jw.surface.area(mesh, x)), float(jw.surface.volume(mesh, x))
    flow = as_system(WillmoreFlow(0.5, 1.0))
    loaded = System(flow, Loads(SurfaceTension(-2.0) + 3.0 * Pressure(1.5)))
    expected = flow.energy_scale(mesh, x) + 2.0 * A + 4.5 * V
    np.testing.assert_allclose(loaded.energy_scale(mesh, x), expected, rtol=1e-12)
    assert float(loaded.energy(mesh, x)) < 0 < float(flow.energy(mesh, x))


def test_the_force_at_a_point_of_known_curvatures():
    r"""$-\sigma H + P - 2 m K - (\phi H + \partial_\nu\phi)$ where $A$ = diag(3, −0.5, 0)."""
    law = Loads(2.0 * ExternalPotential(lambda p: 0.3 + p[0] * p[2]))
    nu = Jet(jnp.array([0.0, 0.0, 1.0]), jnp.diag(jnp.array([3.0, -0.5, 0.0])))
    hat = SimpleNamespace(H=Jet(jnp.asarray(2.5), jnp.zeros(3)), nu=nu)
    here = point(jnp.array([0.4, 0.0, 0.7]), jnp.eye(3)[:, :2])

    def force(*multipliers):
        flow, nothing = System(WillmoreFlow(), law), SimpleNamespace()
        return flow.local(here, nothing, hat, hat, nothing, jnp.array(multipliers)).force()

    phi, slope = 0.3 + 0.4 * 0.7, 0.4
    outside = -2.0 * (phi * 2.5 + slope)
    np.testing.assert_allclose(force(0.0, 0.0, 0.0), outside, rtol=1e-14)
    expected = -1.1 * 2.5 + 0.7 - 2 * 0.9 * (3.0 * -0.5) + outside
    np.testing.assert_allclose(force(1.1, 0.7, 0.9), expected, rtol=1e-14)


def test_multipliers_are_the_slopes_of_the_energy_where_nothing_is_held():
    r"""$\sigma = \partial_A f$, $P = -\partial_V f$, $m = \partial_M f$ solve the closures, and
    area and volume theirs."""
    mesh, x = jw.mesh.icosphere(0, degree=1)
    A, V, M = jw.surface.area(mesh, x), jw.surface.volume(mesh, x), 2 * jw.surface.area(mesh, x)
    fields = {"H": jnp.full(mesh.n_nodes, 2.0), "nu": x}
    energy = SurfaceTension(0.4) + 2.0 * Pressure(0.3) + AreaDifference(2.0, 0.1, 0.05)
    excess = 0.05 * M - 0.1
    share = 2.0 * np.pi / (A * 0.05**2)
    slopes = 0.4 - 0.5 * share / A * excess**2, 0.6, share * 0.05 * excess

    def closures(law, multipliers=slopes):
        flow = System(WillmoreFlow(), law)
        return flow.closures(whole(flow, mesh, x, fields, multipliers=multipliers))

    np.testing.assert_allclose(closures(Loads(energy)), 0.0, atol=1e-12)
    held = closures(Loads(energy, area=1.25 * A, volume=0.8 * V), (0.0, 0.0, slopes[2]))
    np.testing.assert_allclose(held, [-0.2, 0.25, 0.0], atol=1e-12)


@pytest.mark.slow
def test_a_constant_in_the_energy_does_not_end_a_run():
    """At a held volume a pressure adds −PV to the energy and does nothing.

    It is chosen so that the energy passes through zero, where no rise is small against |E|; with
    42 nodes the energy creeps up by a few 1e-6 of its terms in many steps.
    """
    mesh, x = jw.mesh.ellipsoid(semi_axes=(1.0, 1.0, 2.0), level=0, degree=2)
    V0 = jw.surface.volume(mesh, x)

    def run(energy):
        flow = System(WillmoreFlow(), Loads(Pressure(energy / V0), volume=V0))
        return jw.evolve.evolve(flow, mesh, x, t1=0.4, throw=False)

    plain, shifted = run(0.0), run(28.4)
    assert plain.succeeded and shifted.succeeded
    assert shifted.records[0]["energy"] > 0 > shifted.records[-1]["energy"]
    assert shifted.stats["rejected_steps"] <= plain.stats["rejected_steps"]
    np.testing.assert_allclose(shifted.state.x, plain.state.x, atol=5e-3)


@pytest.mark.slow
def test_a_replay_has_the_multipliers_of_the_run(ellipsoid):
    mesh, x = ellipsoid
    A0, V0 = jw.surface.area(mesh, x), jw.surface.volume(mesh, x)
    flow = System(WillmoreFlow(), Loads(area=A0, volume=V0))
    run = jw.evolve.evolve(flow, mesh, x, t1=1.0, max_steps=3, throw=False)
    again = jw.evolve.replay(flow, mesh, x, jnp.asarray(run.times))
    assert set(again.multipliers) == {"tension", "pressure", "curvature_multiplier"}
    for name in ("tension", "pressure"):
        expected = [record[name] for record in run.records]
        np.testing.assert_allclose(again.multipliers[name], expected, rtol=1e-5)


@pytest.mark.slow
def test_prescribed_volume_follows_its_function_of_time(ellipsoid):
    mesh, x = ellipsoid
    V0 = jw.surface.volume(mesh, x)
    flow = System(WillmoreFlow(), Loads(volume=lambda t: V0 * (1.0 + t)))
    run = jw.evolve.evolve(flow, mesh, x, t1=0.05, dt0=1e-4)
    for record in run.records:
        np.testing.assert_allclose(record["volume"], V0 * (1.0 + record["t"]), rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(
    "energy, tension, pressure",
    [
        (SurfaceTension(0.3) + 2.0 * Pressure(0.4), lambda A, V: 0.3, lambda A, V: 0.8),
        (
            OsmoticPressure(5.0, 1.0, temperature=1.0, gas_constant=0.5),
            lambda A, V: 0.0,
            lambda A, V: 0.5 * (5.0 / V - 1.0),
        ),
        (AreaPenalty(0.7, 10.0), lambda A, V: 0.7 * (A - 10.0) / 10.0, lambda A, V: 0.0),
    ],
    ids=["tension and pressure", "osmotic", "area penalty"],
)
def test_sphere_follows_its_ordinary_differential_equation(energy, tension, pressure):
    r"""$\dot R = b H_0 (2 - H_0 R)/R^2 - 2\sigma/R + P$ with $b = 2 b_b$."""
    b, H0, t1 = 1.0, 0.5, 0.5

    def rate(t, R):
        A, V = FOUR_PI * R**2, FOUR_PI * R**3 / 3
        return b * H0 * (2 - H0 * R) / R**2 - 2 * tension(A, V) / R + pressure(A, V)

    exact = solve_ivp(rate, (0, t1), [1.0], rtol=1e-10, atol=1e-12).y[0, -1]
    mesh, x = jw.mesh.icosphere(1, degree=2)
    flow = System(WillmoreFlow(b / 2, H0), Loads(energy))
    run = jw.evolve.evolve(flow, mesh, x, t1=t1, rtol=2e-4)
    R = np.sqrt(run.records[-1]["area"] / FOUR_PI)
    assert abs(exact - 1) > 0.05
    # Time stepping error; the mesh contributes 1e-4 on 162 nodes.
    assert abs(R - exact) < 3e-3 * abs(exact - 1) + 5e-4, (R, exact)


@pytest.mark.slow
def test_tension_and_pressure_of_a_constrained_shape_satisfy_scale_invariance(ellipsoid):
    r"""At an equilibrium with $H_0 = 0$: $2\sigma A = 3 P V_p$."""
    mesh, x = ellipsoid
    A0, V0 = jw.surface.area(mesh, x), jw.surface.volume(mesh, x)
    flow = System(WillmoreFlow(), Loads(area=A0, volume=V0), MinimalDeformation())
    run = jw.evolve.evolve(flow, mesh, x, t1=20.0, stationary_tolerance=1e-5)
    last = run.records[-1]
    assert last["tension"] < 0 and last["pressure"] < 0
    ratio = 2 * last["tension"] * A0 / (3 * last["pressure"] * V0)
    np.testing.assert_allclose(ratio, 1.0, atol=5e-3)  # discretisation error on 162 nodes


def test_targets_that_no_surface_has_are_refused():
    with pytest.raises(ValueError, match="reduced volume would be 1.1"):
        Loads(area=FOUR_PI, volume=1.1 * FOUR_PI / 3)
    with pytest.raises(ValueError, match="`area` must be positive; got -1"):
        Loads(area=-1.0)
    with pytest.raises(ValueError, match="Willmore is local"):
        Loads(jw.energies.Willmore())
    with pytest.raises(ValueError, match="scheme='implicit'"):
        mesh, _ = jw.mesh.icosphere(0, degree=1)
        jw.evolve.Stepper(System(WillmoreFlow(), Loads()), mesh, scheme="linearly-implicit")

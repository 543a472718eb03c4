"""New meshes within a run: nothing is lost but the old triangles, and derivatives pass."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.energies import GinzburgLandau, Willmore
from jaxwillmore.evolve import (
    Remeshing,
    Stepper,
    evolve,
    name_of,
    parts_of,
    replay,
    solution_of,
)
from jaxwillmore.evolve._checks import checked_remeshing
from jaxwillmore.evolve._remeshing import NewMesh, Refused, history_on, moved, new_mesh
from jaxwillmore.flows import (
    CahnHilliard,
    GivenMotion,
    HelfrichFlow,
    Loads,
    MeanCurvatureFlow,
    MinimalDeformation,
    Mixing,
    System,
    WillmoreFlow,
)
from jaxwillmore.mesh import ellipsoid
from jaxwillmore.surface import area, volume

from ..helpers import observed_order, taylor_remainders

MESH, X = ellipsoid((1.0, 1.0, 1.8), 1, 2)
A, V = float(area(MESH, X)), float(volume(MESH, X))
# Triangles of 42 vertices change the energy by a percent; any angle below 44 degrees is too small.
OFTEN = Remeshing(least_angle=44.0, every=2, energy_change=0.1)
T1 = 0.004


def flow(modulus=0.5):
    return System(WillmoreFlow(modulus), Loads(area=A, volume=V), MinimalDeformation())


def run(**options):
    return evolve(flow(), MESH, X, **({"t1": T1, "throw": False, "remesh": OFTEN} | options))


@pytest.fixture(scope="module")
def remeshed():
    return run(saveat=T1 / 4)


def test_a_run_goes_on_on_another_mesh(remeshed):
    assert name_of(remeshed.result) == "reached_t1"
    first = remeshed.new_meshes[0]
    assert remeshed.stats["remeshings"] == len(remeshed.new_meshes) and first.step == 2
    assert not np.array_equal(first.mesh.cells, MESH.cells)
    assert (first.mesh.n_nodes, first.mesh.degree) == (MESH.n_nodes, 2)
    assert remeshed.mesh is remeshed.new_meshes[-1].mesh
    # Every state belongs to the mesh that it says: as smooth there as the surface is.
    for state in (remeshed.state, *remeshed.saved):
        assert float(Willmore()(state.mesh, state.x)) < 1.15 * float(Willmore()(MESH, X))
    before = [state for state in remeshed.saved if state.t < first.t]
    assert before and all(np.array_equal(state.mesh.cells, MESH.cells) for state in before)


def test_area_and_volume_stay_and_the_energy_only_rises_with_a_mesh(remeshed):
    records = remeshed.records
    for record in records:
        assert abs(record["area"] / A - 1) < 1e-11 and abs(record["volume"] / V - 1) < 1e-11
    for new in remeshed.new_meshes:
        assert abs(new.changes["restored_area"]) < 1e-12
        assert abs(new.changes["restored_volume"]) < 1e-12
        # By interpolation between 42 vertices alone it would be a percent.
        assert abs(new.changes["area"]) < 0.03
    rises = {new.step: new.changes["energy"] * records[0]["energy"] for new in remeshed.new_meshes}
    for before, after in zip(records, records[1:], strict=False):
        jump = rises.get(before["step"], 0.0)
        assert after["energy"] <= before["energy"] + jump + 1e-3 * abs(jump) + 1e-5 * A


def test_a_run_through_a_new_mesh_goes_on_to_the_last_bit(remeshed):
    """Stopped before the new mesh, and after it, and read from a file."""
    assert len(remeshed.records) >= 4
    for last in (1, 3):
        half = run(saveat=T1 / 4, observer=lambda record, _, k=last: record["step"] == k)
        assert len(half.records) == last
        again = run(saveat=T1 / 4, resume=solution_of(*parts_of(half)))
        (words, arrays), (other, others) = parts_of(again), parts_of(remeshed)
        for said in (words, other):
            said["stats"] = said["stats"] | {"wall_seconds": None}
        assert words == other and list(arrays) == list(others)
        assert all(a.tobytes() == others[name].tobytes() for name, a in arrays.items())


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("nodes", lambda a: a + 1, "the new mesh 0 comes from nodes that are not there"),
        ("weights", lambda a: a[:, 1:], "weights of the new mesh 0"),
        ("offset", lambda a: a[1:], "offset of the new mesh 0"),
    ],
)
def test_new_meshes_that_do_not_fit_are_refused(remeshed, name, change, message):
    words, arrays = parts_of(remeshed)
    arrays[f"new_meshes.0.{name}"] = change(arrays[f"new_meshes.0.{name}"])
    with pytest.raises((ValueError, TypeError), match=f"{message}|{name}"):
        solution_of(words, arrays)


def test_other_settings_are_another_run(remeshed):
    half = run(observer=lambda record, _: record["step"] == 1)
    with pytest.raises(ValueError, match=r"remesh.least_angle` = 44.0; got 20"):
        run(remesh=dataclasses.replace(OFTEN, least_angle=20.0), resume=half)
    with pytest.raises(ValueError, match="`remesh` = True; got False"):
        run(remesh=None, resume=half)


def test_nothing_is_compiled_for_a_new_mesh(remeshed):
    """It has as many nodes, triangles and pairs of nodes as the old one."""
    assert len(remeshed.new_meshes) >= 1
    compiled = []

    def seen(name, *_, **__):
        if "backend_compile" in name:
            compiled.append(name)

    jax.monitoring.register_event_duration_secs_listener(seen)
    try:
        run(saveat=T1 / 4)
        assert not compiled
        jax.jit(lambda x: x + 17.25)(jnp.ones(3))
        assert compiled  # the listener hears
    finally:
        jax.monitoring.clear_event_listeners()


def test_a_mesh_that_changes_the_energy_too_much_is_not_used():
    plain = run(remesh=None)
    held = run(remesh=dataclasses.replace(OFTEN, energy_change=1e-9))
    assert not held.new_meshes and held.stats["refused_remeshings"] >= 2
    assert "would change the energy by" in held.stats["refused_because"]
    assert held.records == plain.records
    np.testing.assert_array_equal(held.state.x, plain.state.x)


@pytest.fixture(scope="module")
def two_phases():
    """A system with a concentration, and a history of three states of it."""
    energy = GinzburgLandau(1.0, 0.4)
    stepper = Stepper(System(WillmoreFlow(), Mixing(energy), CahnHilliard()), MESH)
    flow, rng = stepper.problem.flow, np.random.default_rng(0)
    history = stepper.start(0.0, X, {}, 3)
    for t in (1.0, 2.0):
        x = X * (1 + 0.01 * t) + 0.002 * jnp.sin(3 * X[:, ::-1])
        U = jnp.asarray(rng.normal(size=history.U.shape[1:]))
        history = history.push(t, x, U, stepper.amounts(x, U), jnp.zeros(flow.n_globals))
    return stepper, history


def test_the_amount_of_a_concentration_stays(two_phases):
    stepper, history = two_phases
    new = new_mesh(OFTEN, 2, 2.0, MESH, history.x[0])
    after = history_on(new, stepper.on(new.mesh), history)
    before, now = (np.sum(h.amounts, axis=1) for h in (history, after))
    assert np.min(np.abs(before[:2])) > 1e-3
    np.testing.assert_allclose(now, before, rtol=1e-12, atol=1e-13)
    # The vectors are those of the fields.
    for k in range(3):
        own = stepper.on(new.mesh).amounts(after.x[k], after.U[k])
        np.testing.assert_allclose(after.amounts[k], own, atol=1e-14)


def test_the_new_surface_has_the_area_and_volume_of_the_old_one(two_phases):
    """The last state of the history, which is what a run goes on from."""
    stepper, history = two_phases
    new = new_mesh(OFTEN, 2, 2.0, MESH, history.x[0])
    after = history_on(new, stepper.on(new.mesh), history)
    for measure in (area, volume):
        old = float(measure(MESH, history.x[0]))
        assert float(measure(new.mesh, after.x[0])) == pytest.approx(old, rel=1e-11)


def test_coarse_triangles_where_the_surface_bends_ask_for_a_new_mesh():
    """The tips of a needle in a mesh of even, good triangles; by curvature it is better."""
    mesh, x = ellipsoid((1.0, 1.0, 4.0), 3, 1)
    even = meshes.remesh(mesh, x)
    uniform, curved = (Remeshing(least_angle=20.0, size=size) for size in ("uniform", "curvature"))
    assert not uniform.is_due(even.mesh, even.x) and curved.is_due(even.mesh, even.x)
    better = curved.remeshed(even.mesh, even.x)
    assert not curved.is_due(better.mesh, better.x)
    assert better.mesh.n_vertices == even.mesh.n_vertices


def test_no_velocity_comes_from_a_new_mesh(two_phases):
    """Differences between states are those of the old nodes, interpolated; so is every rate."""
    stepper, history = two_phases
    new = new_mesh(OFTEN, 2, 2.0, MESH, history.x[0])
    after = history_on(new, stepper.on(new.mesh), history)
    old = new.transfer(history.x[0] - history.x[1])
    np.testing.assert_allclose(after.x[0] - after.x[1], old, atol=1e-14)
    np.testing.assert_allclose(np.sum(new.weights, axis=1), 1.0, atol=1e-13)


def test_a_surface_too_coarse_for_new_triangles_keeps_its_own():
    """The tips of a needle: new triangles of the mean size would fold over."""
    mesh, x = ellipsoid((1.0, 1.0, 6.0), 1, 2)
    stepper = Stepper(WillmoreFlow(), mesh)
    history = stepper.start(0.0, x, {}, 3)
    found = moved(OFTEN, stepper, history, 1, 40.0, 40.0)
    assert isinstance(found, Refused) and "fold over" in found.reason


def test_only_what_comes_along_can_be_remeshed():
    nodal = HelfrichFlow(0.5, spontaneous_curvature=0.1 * X[:, 2])
    with pytest.raises(ValueError, match=r"needs `spontaneous_curvature` .*MinimalDeformation"):
        evolve(nodal, MESH, X, t1=1.0, remesh=OFTEN)
    with pytest.raises(ValueError, match="nodes have a given path"):
        evolve(System(GivenMotion(lambda t, p: (1 + t) * p, X)), MESH, X, t1=1.0, remesh=OFTEN)
    with pytest.raises(ValueError, match=r"must be a `Remeshing`, or None; got float"):
        checked_remeshing(15.0, flow())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"least_angle": 0.0}, "`least_angle` must be between 0 and 45"),
        ({"least_angle": 60.0}, "`least_angle` must be between 0 and 45"),
        ({"size": "fine"}, "`size` must be one of"),
        ({"every": 0}, "`every` must be an integer"),
        ({"energy_change": np.inf}, "`energy_change` must be a positive number"),
    ],
)
def test_settings_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Remeshing(**options)


def test_new_meshes_belong_to_their_times(remeshed):
    times, new = jnp.asarray(remeshed.times), remeshed.new_meshes
    with pytest.raises(ValueError, match=r"`times` has 1 steps"):
        replay(flow(), MESH, X, times[:2], new_meshes=new)
    other = ellipsoid((1.0, 1.0, 1.8), 0, 2)
    with pytest.raises(ValueError, match=r"meshes of \[162\] nodes; this one has 42"):
        replay(WillmoreFlow(), *other, times, new_meshes=new)


@pytest.mark.slow
def test_derivatives_pass_through_new_meshes(remeshed):
    """By a parameter and by the initial shape, of a replay that is the run."""
    times, new = jnp.asarray(remeshed.times), remeshed.new_meshes
    assert 0 < new[0].step < len(remeshed.times) - 1

    def end(modulus, x):
        return replay(flow(modulus), MESH, x, times, new_meshes=new)

    last = end(0.5, X)
    assert bool(last.converged) and last.x.shape == (len(times), MESH.n_nodes, 3)
    np.testing.assert_allclose(last.x[-1], remeshed.state.x, atol=1e-6)

    def quartic(modulus, x):
        return jnp.sum(end(modulus, x).x[-1] ** 4)

    way = 0.1 * jnp.sin(2 * X[:, ::-1])

    def along(s):
        return quartic(0.5 + 0.3 * s, X + s * way)

    sizes = [2.0**-k for k in (3, 4, 5)]
    remainders = taylor_remainders(along, jnp.zeros(()), jnp.ones(()), sizes)
    assert observed_order(sizes, remainders) == pytest.approx(2.0, abs=0.1)
    slope = jax.jvp(along, (jnp.zeros(()),), (jnp.ones(()),))[1]
    by_modulus, by_x = jax.grad(quartic, argnums=(0, 1))(0.5, X)
    assert float(0.3 * by_modulus + jnp.sum(by_x * way)) == pytest.approx(float(slope), rel=1e-7)


@pytest.mark.slow
def test_twenty_new_meshes_cost_less_than_a_thousandth_of_the_energy():
    mesh, x = ellipsoid((1.0, 1.0, 1.6), 2, 2)
    measures = float(area(mesh, x)), float(volume(mesh, x))
    laws = WillmoreFlow(), Loads(area=measures[0], volume=measures[1]), MinimalDeformation()
    found = evolve(
        System(*laws),
        mesh,
        x,
        t1=5.0,
        rtol=3e-4,
        remesh=Remeshing(least_angle=44.9, every=1),
        max_steps=24,
        throw=False,
    )
    assert len(found.new_meshes) >= 20
    assert abs(sum(new.changes["energy"] for new in found.new_meshes)) < 1e-3
    last = found.records[-1]
    assert abs(last["area"] / measures[0] - 1) < 1e-11
    assert abs(last["volume"] / measures[1] - 1) < 1e-11
    # The fields are still those of the surface.
    assert abs(last["willmore_of_field"] / last["willmore"] - 1) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("size", ["uniform", "curvature"])
def test_an_ellipsoid_of_one_to_six_becomes_a_better_sphere(size):
    """Without any motion along the surface; 4e-3 above 8π on the triangles of the start."""
    mesh, x = ellipsoid((1.0, 1.0, 6.0), 2, 2)
    remesh = Remeshing(least_angle=20.0, size=size, energy_change=0.1)
    found = evolve(
        WillmoreFlow(), mesh, x, t1=300.0, stationary_tolerance=1e-4, remesh=remesh, throw=False
    )
    assert name_of(found.result) == "stationary" and found.new_meshes
    assert found.records[-1]["energy"] == pytest.approx(8 * np.pi, rel=2e-4)


@pytest.mark.slow
def test_a_neck_is_followed_to_a_fraction_of_its_thickness():
    """A dumbbell under mean curvature flow, of which half a thousandth of the length is left.

    An axisymmetric computation with 400 points ends at t = 0.024268.
    """
    mesh, x = meshes.dumbbell(level=2, degree=2, neck=0.2)
    flow = System(MeanCurvatureFlow(), MinimalDeformation())
    thickness = {}
    for remesh in (None, Remeshing(least_angle=20.0, energy_change=0.1)):
        found = evolve(flow, mesh, x, t1=1.0, remesh=remesh, throw=False)
        assert name_of(found.result) == "pinching"
        assert found.stats["singular_time"] == pytest.approx(0.024268, rel=0.02)
        nodes = np.asarray(found.state.x)
        middle = nodes[np.abs(nodes[:, 0]) < 0.08]
        thickness[remesh is None] = np.min(np.hypot(middle[:, 1], middle[:, 2]))
    assert thickness[False] < 0.3 * thickness[True] < 0.005


def test_a_new_mesh_is_found_in_what_a_run_leaves(remeshed):
    new = remeshed.new_meshes[0]
    assert isinstance(new, NewMesh)
    names = {"energy", "area", "volume", "restored_area", "restored_volume", "least_angle"}
    assert names < set(new.changes)
    assert new.changes["least_angle"] > new.changes["least_angle_before"] - 5

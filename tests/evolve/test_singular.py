"""Runs that end where the flow itself ends: points, pinches, contacts, with their times."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import mesh as meshes
from jaxwillmore.equilibria import branch, equilibrium, spheroid
from jaxwillmore.evolve import RESULTS, evolve, name_of
from jaxwillmore.evolve._singular import explained, order_of, singular_time
from jaxwillmore.flows import (
    Loads,
    MeanCurvatureFlow,
    MinimalDeformation,
    SurfaceDiffusion,
    System,
    WillmoreFlow,
)

NECK = System(MeanCurvatureFlow(), MinimalDeformation())


def test_the_order_of_a_law_is_that_of_its_time_scale():
    assert order_of(System(MeanCurvatureFlow())) == pytest.approx(2, abs=1e-10)
    assert order_of(System(SurfaceDiffusion())) == pytest.approx(4, abs=1e-10)


@pytest.mark.parametrize("order", [2.0, 4.0])
def test_the_time_of_a_blow_up_is_exact_for_its_own_power(order):
    """(T − t)^(−1/p), to the last digits of T − t and with another behaviour before."""
    T, left = 3.7, np.geomspace(1.0, 1e-9, 60)
    k = np.where(left < 1e-4, left ** (-1 / order), 1.0)
    records = [{"t": T - s, "max_curvature": size} for s, size in zip(left, k, strict=True)]
    found = singular_time(order, records)
    assert found == pytest.approx(T, abs=1e-13)
    assert singular_time(order, records[:3]) is None
    falling = [r | {"max_curvature": 1 / r["max_curvature"]} for r in records]
    assert singular_time(order, falling) is None


def test_only_a_curvature_that_blows_up_is_a_pinch():
    """Of a surface of unit radius: 1/√(T − t), and then one that stays as it is."""
    flow, left = System(MeanCurvatureFlow()), np.geomspace(1.0, 1e-4, 40)
    records = [{"t": 1 - s, "area": 4 * np.pi, "max_curvature": s**-0.5} for s in left]
    assert name_of(explained(RESULTS.step_too_small, flow, 0.0, records)[0]) == "pinching"
    assert explained(RESULTS.energy_rising, flow, 0.0, records)[1] == pytest.approx(1.0)
    assert name_of(explained(RESULTS.step_limit, flow, 0.0, records)[0]) == "step_limit"
    for other in (
        [r | {"max_curvature": 90.0} for r in records],  # sharp from the start
        [r | {"max_curvature": 1 + 0.01 * r["t"]} for r in records],  # hardly sharper
        [r | {"area": 1e-4} for r in records],  # no sharper than its size
    ):
        found = explained(RESULTS.step_too_small, flow, 0.0, other)
        assert name_of(found[0]) == "step_too_small" and found[1] is None


def test_a_sphere_vanishes_when_its_radius_does():
    """R² = 1 − 4t under V = −H: at t = 1/4, less 1 % on 42 nodes, and the error of large steps."""
    mesh, x = meshes.icosphere(0, 2)
    found = evolve(MeanCurvatureFlow(), mesh, x, t1=1.0, rtol=3e-3, throw=False)
    assert name_of(found.result) == "vanished" and not found.succeeded
    assert found.stats["singular_time"] == pytest.approx(0.25, rel=0.03)
    assert found.state.t < found.stats["singular_time"]
    assert np.all(np.isfinite(found.state.x))


def test_a_surface_through_itself_is_a_contact_from_the_start():
    mesh, x = meshes.from_sphere_map(lambda p: p * jnp.array([1.0, 1.0, 0.5]), 1, 2)
    middle = np.asarray(x[:, 0] ** 2 + x[:, 1] ** 2)
    crossed = x * jnp.stack([jnp.ones(len(x)), jnp.ones(len(x)), middle - 0.2], axis=1)
    for stops, end in ((False, "step_limit"), (True, "contact")):
        found = evolve(
            MeanCurvatureFlow(),
            mesh,
            crossed,
            t1=1.0,
            self_contact=stops,
            max_steps=1,
            throw=False,
            dt0=1e-7,
        )
        assert name_of(found.result) == end
        assert found.stats["steps"] == 1 - stops


@pytest.mark.slow
def test_a_neck_pinches_at_the_time_of_a_finer_mesh():
    """A dumbbell under mean curvature flow; the state that is left is still one surface."""
    times = []
    for level in (2, 3):
        mesh, x = meshes.dumbbell(level=level, degree=2, neck=0.2)
        found = evolve(NECK, mesh, x, t1=1.0, throw=False)
        assert name_of(found.result) == "pinching"
        assert np.all(np.isfinite(found.state.x))
        times.append(found.stats["singular_time"])
    assert times[0] == pytest.approx(times[1], rel=0.03)


@pytest.mark.slow
def test_the_poles_of_a_deflated_vesicle_touch_where_those_of_equilibria_meet():
    """An oblate that loses volume slowly, and the branch of oblates at rest, which passes through
    itself: where the distance of its poles, as a function of the reduced volume, is zero, at .5019
    on this mesh."""
    mesh, x = spheroid(0.6, "oblate", level=2)
    options = {"area": 4 * np.pi, "reduced_volume": 0.6}
    start = equilibrium(mesh, x, search="stationary", throw=False, **options)
    family = branch(start, stop=0.505, max_step=0.02, stability=False)
    v = np.array([row["reduced_volume"] for row in family.rows])
    poles = [
        np.sort(np.asarray(p.x)[np.argsort(np.hypot(*p.x.T[:2]))[:2], 2]) for p in family.points
    ]
    touching = float(np.polyfit([upper - lower for lower, upper in poles], v, 2)[-1])
    ball = 4 * np.pi / 3

    def less(t):
        return (0.6 - 0.15 * t / 100) * ball

    laws = WillmoreFlow(), Loads(area=4 * np.pi, volume=less), MinimalDeformation()
    found = evolve(System(*laws), mesh, start.x, t1=100.0, self_contact=True, throw=False)
    assert name_of(found.result) == "contact"
    assert less(found.stats["singular_time"]) / ball == pytest.approx(touching, abs=1e-3)

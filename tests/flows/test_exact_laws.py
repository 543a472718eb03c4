"""Flows against laws that are known exactly: orders in time, rates of modes, conservation."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.energies import OsmoticPressure, Pressure, SurfaceTension
from jaxwillmore.flows import Loads, MinimalDeformation, SurfaceDiffusion, System, WillmoreFlow
from jaxwillmore.surface import Sphere
from jaxwillmore.verify import (
    TimeStudy,
    balanced_flow,
    loaded_sphere_problem,
    mode_errors,
    mode_rate,
    speed_problem,
)

OSMOTIC = OsmoticPressure(5.0, 1.0, temperature=1.0, gas_constant=0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "problem",
    [
        loaded_sphere_problem(SurfaceTension(0.3) + Pressure(0.8), 0.5, 0.5, 0.5),
        loaded_sphere_problem(OSMOTIC, 0.3),
        speed_problem(None, 0.1),
        speed_problem(lambda H: -1 / H, 0.4),
        speed_problem(lambda H: H**2, 0.04),
    ],
    ids=["H0, tension, pressure", "osmotic", "mean curvature", "inverse", "square"],
)
def test_spheres_follow_their_law_at_the_order_of_the_scheme(problem):
    """Against short steps on the same 162 nodes, whose own error is that of the mesh."""
    study = TimeStudy(problem, degree=2, level=1, n_reference=160)
    for bdf_order, allowed in ((1, 0.15), (2, 0.25)):
        last = study.orders(bdf_order, (40, 80))[-1]
        assert abs(last["x_l2_order"] - bdf_order) < allowed, last
    area = float(jw.surface.area(study.mesh, study.reference.x))
    exact = problem.surface(problem.t1)
    assert isinstance(exact, Sphere)
    np.testing.assert_allclose(np.sqrt(area / (4 * np.pi)), exact.radius, rtol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "flow, rate",
    [
        (balanced_flow(1.0, 1.0), mode_rate(2, 1.0, 0.5, 1.0, 1.0)),
        # On the unit sphere that of Willmore flow.
        (SurfaceDiffusion(), mode_rate(2)),
    ],
    ids=["loaded", "surface diffusion"],
)
def test_an_ellipsoidal_mode_decays_at_its_rate(flow, rate):
    row = mode_errors(2, 2, 1, flow=flow, exact_rate=rate)
    np.testing.assert_allclose(row["rate"], rate, rtol=0.01)


@pytest.mark.slow
def test_area_held_and_volume_prescribed_at_every_step():
    mesh, x = jw.mesh.ellipsoid(semi_axes=(1.0, 1.0, 1.4), level=1, degree=2)
    A, V = jw.surface.area(mesh, x), jw.surface.volume(mesh, x)
    loads = Loads(area=A, volume=lambda t: V * (1 - 2 * t))
    flow = System(WillmoreFlow(), loads, MinimalDeformation())
    run = jw.evolve.evolve(flow, mesh, x, t1=0.05, dt0=1e-4)
    for record in run.records:
        np.testing.assert_allclose(record["area"], A, rtol=1e-10)
        np.testing.assert_allclose(record["volume"], V * (1 - 2 * record["t"]), rtol=1e-10)
    assert float(jnp.max(jnp.abs(run.state.x - x))) > 1e-2

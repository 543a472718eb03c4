"""Runs to the end: surfaces arrive where they must, and stationary ones stay."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import Willmore
from jaxwillmore.evolve import evolve
from jaxwillmore.flows import MinimalDeformation, System, WillmoreFlow
from jaxwillmore.mesh import red_cell, torus
from jaxwillmore.surface import RedCell, Torus, area
from jaxwillmore.verify import surface_errors

pytestmark = pytest.mark.slow
CLIFFORD = 4 * np.pi**2


def exact_fields(surface, x):
    return {"H": surface.mean_curvature(x), "nu": surface.normal(x)}


def test_the_clifford_torus_stands_still():
    """360 nodes at T = 0.2: distance from the exact torus and energy (plain KLL destroys it)."""
    exact = Torus(1.0, np.sqrt(0.5))
    mesh, x = torus(1.0, np.sqrt(0.5), n_major=10, n_minor=9, degree=2)
    solution = evolve(WillmoreFlow(), mesh, x, t1=0.2, initial=exact_fields(exact, x))
    end = solution.state
    distance = surface_errors(mesh, end.x, end.nu, end.H, exact)["x_l2"]
    assert float(distance / jnp.sqrt(area(mesh, end.x))) < 2.5e-3
    assert abs(float(Willmore()(mesh, end.x)) / CLIFFORD - 1) < 7e-4
    assert solution.stats["rejected_steps"] <= 3


def test_a_thin_torus_becomes_the_clifford_torus():
    """R = 1, r = 0.4 from 53.843 to 4π², with even triangles, and the energy only falls."""
    exact = Torus(1.0, 0.4)
    mesh, x = torus(1.0, 0.4, n_major=16, n_minor=12, degree=2)
    flow = System(WillmoreFlow(), MinimalDeformation())
    solution = evolve(flow, mesh, x, t1=0.5, initial=exact_fields(exact, x))
    energies = np.array([record["willmore"] for record in solution.records])
    assert energies[0] > 53.5
    assert abs(energies[-1] / CLIFFORD - 1) < 3e-3
    assert np.all(np.diff(energies) < 1e-5 * energies[:-1])
    assert solution.stats["rejected_steps"] <= 3


def test_the_red_cell_starts_with_its_energy_at_level_4():
    """46.148735 from the nodes alone, to 1e-4."""
    mesh, x = red_cell(level=4, degree=2)
    assert float(Willmore()(mesh, x)) == pytest.approx(46.148735, rel=1e-4)


def test_a_red_cell_of_642_nodes_becomes_a_sphere():
    """Energy of the nodes within 3e-4 of 8π, the area at rest after the transient."""
    mesh, x = red_cell(level=2, degree=2)
    solution = evolve(WillmoreFlow(), mesh, x, t1=5.0, initial=exact_fields(RedCell(), x))
    last = solution.records[-1]
    assert abs(last["willmore"] / (8 * np.pi) - 1) < 3e-4
    late = [record["area"] for record in solution.records if record["t"] >= 0.8]
    assert np.ptp(late) < 5e-3 * late[0]
    assert solution.stats["rejected_steps"] <= 3

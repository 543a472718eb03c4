"""Diagnostics of a state: exact on spheres, and able to see what goes wrong."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.evolve import diagnostics
from jaxwillmore.evolve._record import corner_angles
from jaxwillmore.flows import WillmoreFlow, alignment
from jaxwillmore.mesh import SurfaceMesh, icosphere


@pytest.fixture(scope="module")
def sphere():
    mesh, x = icosphere(1, 2)
    zero = jnp.zeros(mesh.n_nodes)
    return mesh, x, {"H": zero + 2.0, "nu": x, "V": zero, "z": 0 * x}


def record(mesh, x, fields):
    return {k: float(v) for k, v in diagnostics(WillmoreFlow(), mesh, x, fields).items()}


def test_a_sphere_is_described(sphere):
    """All errors are those of 162 nodes: O(h⁴), up to 2e-3 for the energy."""
    mesh, x, fields = sphere
    found = record(mesh, x, fields)
    for name, exact in (
        ("energy", 8 * np.pi),
        ("willmore", 8 * np.pi),
        ("willmore_of_field", 8 * np.pi),
        ("area", 4 * np.pi),
        ("volume", 4 * np.pi / 3),
        ("reduced_volume", 1.0),
    ):
        assert found[name] == pytest.approx(exact, rel=3e-3), name
    assert found["stationarity"] == 0.0
    assert found["normal_length_defect"] < 1e-14
    assert found["normal_distance"] < 0.01
    assert found["alignment"] > 0.999
    assert 50 < found["min_angle"] <= 60 <= found["max_angle"] < 75


def test_defects_are_measured(sphere):
    mesh, x, fields = sphere
    long = record(mesh, x, fields | {"nu": 1.1 * x})
    assert long["normal_length_defect"] == pytest.approx(0.1)
    assert long["normal_distance"] == pytest.approx(0.1, rel=0.02)
    fast = record(mesh, x, fields | {"V": jnp.full(mesh.n_nodes, -0.25)})
    # Relative to R/T with T = R⁴ for b_b = ½, and R = 1 up to the error of the area.
    assert fast["stationarity"] == pytest.approx(0.25, rel=1e-2)
    # The size of the surface does not enter, in its own units.
    R = 10.0
    same = record(mesh, R * x, fields | {"V": jnp.full(mesh.n_nodes, -0.25 / R**3)})
    assert same["stationarity"] == pytest.approx(fast["stationarity"], rel=1e-10)
    inward = record(mesh, x, fields | {"nu": -x})
    assert inward["alignment"] < -0.999


def test_one_turned_cell_is_enough(sphere):
    """Where ν_h and the cell disagree about the outside, and nowhere else."""
    mesh, x, _ = sphere
    nu = x.at[mesh.cells[7]].multiply(-1.0)
    inside = alignment(mesh, x, nu)
    assert int(jnp.argmin(inside)) == 7 and float(inside[7]) < -0.99
    assert float(jnp.max(inside)) > 0.99


def test_angles_of_known_triangles():
    x = jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, np.sqrt(3), 0.0], [0.0, 0.0, 1.0]])
    cells = jnp.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = SurfaceMesh(cells=cells, degree=1, n_nodes=4)
    angles = corner_angles(mesh, x)
    np.testing.assert_allclose(angles[0], [90.0, 30.0, 60.0], rtol=1e-13)
    np.testing.assert_allclose(angles[1], [90.0, 45.0, 45.0], rtol=1e-13)
    np.testing.assert_allclose(jnp.sum(angles, axis=1), 180.0, rtol=1e-13)

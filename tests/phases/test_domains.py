"""Domains are counted as one sees them."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.mesh import icosphere, torus
from jaxwillmore.phases import domains


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_caps_and_the_belt_between_them_are_counted(degree):
    mesh, x = icosphere(2 if degree == 1 else 1, degree)
    z = np.asarray(x[:, 2])
    two = np.where(abs(z) > 0.6, 1.0, 0.0)
    assert (domains(mesh, two), domains(mesh, 1 - two)) == (2, 1)
    one = np.where(z > 0.0, 1.0, 0.0)
    assert (domains(mesh, one), domains(mesh, 1 - one)) == (1, 1)


def test_a_pure_phase_is_one_domain_and_the_other_none():
    mesh, _ = icosphere(0, 2)
    assert (domains(mesh, jnp.ones(42)), domains(mesh, jnp.zeros(42))) == (1, 0)


def test_every_peak_of_a_wave_around_a_torus_is_a_domain():
    mesh, x = torus(1.0, 0.4, level=1, degree=2)
    angle = np.arctan2(x[:, 1], x[:, 0])
    assert domains(mesh, 0.5 + 0.5 * np.cos(3 * angle)) == 3
    # Two peaks meet below a lower level.
    assert domains(mesh, 0.5 + 0.5 * np.cos(3 * angle), level=-0.1) == 1


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_a_node_is_a_domain_of_its_own_unless_its_neighbours_join_it(degree):
    """Alone it is one, and all nodes of one cell are one."""
    mesh, _ = icosphere(0, degree)
    alone = np.zeros(mesh.n_nodes)
    alone[5] = 1.0
    assert domains(mesh, alone) == 1
    cell = np.zeros(mesh.n_nodes)
    cell[np.asarray(mesh.cells)[7]] = 1.0
    assert domains(mesh, cell) == 1
    corners = np.zeros(mesh.n_nodes)
    corners[np.asarray(mesh.cells)[7, :3]] = 1.0
    assert domains(mesh, corners) == (1 if degree == 1 else 3)


def test_a_field_of_another_length_is_refused():
    mesh, _ = icosphere(0, 2)
    with pytest.raises(ValueError, match=r"each of the 42 nodes; got \(7,\)"):
        domains(mesh, np.ones(7))

"""Equilibria that several tests look at; solving for them compiles what the tests share."""

import pytest

import jaxwillmore as jw  # noqa: F401  (64-bit floats)
from jaxwillmore import equilibria


@pytest.fixture(scope="session")
def prolate():
    """The prolate of reduced volume 0.8 with 162 nodes, in units that are not one."""
    mesh, x = equilibria.spheroid(0.8, "prolate", level=1)
    return equilibria.equilibrium(
        mesh, 3.0 * x, reduced_volume=0.8, bending_modulus=0.7, spontaneous_curvature=0.0
    )


@pytest.fixture(scope="session")
def disc():
    """The oblate of reduced volume 0.69 with 42 nodes, which have a pitchfork at 0.71."""
    mesh, x = equilibria.spheroid(0.69, "oblate", level=0)
    return equilibria.equilibrium(mesh, x, reduced_volume=0.69)


@pytest.fixture(scope="session")
def whole(disc):
    """The branch from it through the pitchfork, and what it handed out on the way."""
    handed = []
    return equilibria.branch(disc, stop=0.72, max_step=0.01, checkpoints=handed.append), handed

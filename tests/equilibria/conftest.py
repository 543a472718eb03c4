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

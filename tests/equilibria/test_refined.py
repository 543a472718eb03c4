"""Equilibria by way of coarse ones: as right as direct ones, and a coarse failure is refused."""

import equinox as eqx
import pytest

from jaxwillmore import equilibria

# E/(8πκ) of an axisymmetric spectral solver.
PROLATE = 1.387440432


def test_refined_equilibrium_has_a_fraction_of_the_error(prolate):
    fine = equilibria.refined(prolate, stability=False)
    assert fine.succeeded and fine.residual < 1e-10
    assert fine.mesh.n_nodes == 642
    coarse_error = float(prolate.bending_over_8pi_kappa) - PROLATE
    error = float(fine.bending_over_8pi_kappa) - PROLATE
    # A quarter of the size of triangles; seen: 6.7e-5 from 3.2e-4.
    assert abs(error) < 1.0e-4 and abs(error) < abs(coarse_error) / 4
    # Units, held numbers and parameters are those of the coarse one.
    assert float(fine.parameters.volume) == pytest.approx(float(prolate.parameters.volume))
    assert float(fine.scaled_pressure) == pytest.approx(-12.78, rel=1e-3)
    assert fine.stats["outer_steps"] == 0 and fine.stats["newton_iterations"] < 20


def test_refining_with_free_volume_keeps_the_pressure(prolate):
    free = equilibria.equilibrium(
        prolate.mesh, prolate.x, bending_modulus=0.7, pressure=float(prolate.pressure)
    )
    fine = equilibria.refined(free, stability=False)
    assert float(fine.pressure) == pytest.approx(float(free.pressure), rel=1e-12)
    assert float(fine.reduced_volume) == pytest.approx(0.8, rel=2e-3)


def test_what_has_not_converged_is_not_refined(prolate):
    failed = eqx.tree_at(lambda e: e.result, prolate, equilibria.RESULTS.not_settled)
    with pytest.raises(ValueError, match="converged"):
        equilibria.refined(failed)

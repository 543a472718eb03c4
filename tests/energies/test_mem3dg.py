"""Mem3DG's parameters: its own formulas on spheres, in its own convention."""

import numpy as np
import pytest

from jaxwillmore.energies import AbstractGlobalEnergy, CanhamHelfrich, from_mem3dg, terms_of
from jaxwillmore.mesh import icosphere

R = 1.5
A, V, MEAN = 4 * np.pi * R**2, 4 * np.pi * R**3 / 3, 1 / R  # MEAN is H̄ = (κ₁ + κ₂)/2
RT = 8.314462618e-3 * 310.0


@pytest.fixture(scope="module")
def sphere():
    return icosphere(1, 2, radius=R)


@pytest.mark.parametrize(
    "arguments, expected",
    [
        ({}, 2 * MEAN**2 * A),
        ({"H0": 0.4}, 2 * (MEAN - 0.4) ** 2 * A),
        ({"H0": 0.4, "half_bending": True}, (MEAN - 0.4) ** 2 * A),
        ({"Kg": 0.3}, 2 * MEAN**2 * A + 0.3 * 4 * np.pi),
        ({"tension": 0.2}, 2 * MEAN**2 * A + 0.2 * A),
        ({"pressure": 0.2}, 2 * MEAN**2 * A - 0.2 * V),
        ({"modulus": 0.5, "preferred_area": 20.0}, 2 * MEAN**2 * A + 0.25 * (A - 20) ** 2 / 20),
        (
            {"strength": 0.5, "preferred_volume": 9.0},
            2 * MEAN**2 * A + 0.25 * ((V - 9.0) / 9.0) ** 2,
        ),
        (
            {"enclosed_solute": 5.0, "ambient_concentration": 0.4, "temperature": 310.0},
            2 * MEAN**2 * A + RT * 5 * (0.4 * V / 5 - np.log(0.4 * V / 5) - 1),
        ),
        (
            {"alpha": 0.8, "D": 0.1, "dA0": 3.0},
            2 * MEAN**2 * A + 0.8 * np.pi / (4 * 0.1**2 * A) * (2 * 0.1 * MEAN * A - 3.0) ** 2,
        ),
    ],
    ids=lambda value: ", ".join(value) if isinstance(value, dict) else "",
)
def test_its_formulas_on_a_sphere(sphere, arguments, expected):
    """With Kb = 1. The mesh of 162 nodes errs by 2.5e-3 of ∫2H̄² = 8π."""
    found = from_mem3dg(1.0, **arguments)(*sphere)
    np.testing.assert_allclose(found, expected, atol=4e-3 * 8 * np.pi)


def test_the_sum_is_made_of_energies_that_a_flow_knows():
    energy = from_mem3dg(
        8.22e-5, modulus=0.1, preferred_area=12.4866, strength=0.02, preferred_volume=2.932
    )
    bending, *rest = [term for _, term in terms_of(energy)]
    assert isinstance(bending, CanhamHelfrich)
    np.testing.assert_allclose(bending.bending_modulus, 4.11e-5, rtol=1e-14)
    assert len(rest) == 2 and all(isinstance(term, AbstractGlobalEnergy) for term in rest)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"Kb": -1.0}, "`Kb` must be positive; got -1"),
        ({"Kb": 1.0, "modulus": 0.5}, "`preferred_area` is missing"),
        ({"Kb": 1.0, "preferred_volume": 0.5}, "`strength` is missing"),
        ({"Kb": 1.0, "alpha": 1.0}, "`alpha` needs the thickness `D`"),
        ({"Kb": 1.0, "alpha": 1.0, "D": 0.1, "half_bending": True}, "cannot be translated"),
        ({"Kb": [1.0, 2.0], "alpha": 1.0, "D": 0.1}, "`Kb` must be one finite number"),
    ],
)
def test_what_cannot_be_translated_is_said(arguments, message):
    with pytest.raises(ValueError, match=message):
        from_mem3dg(**arguments)

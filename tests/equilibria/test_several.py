"""Several equilibria at one set of parameters: all that are known are found, once, in order."""

import numpy as np
import pytest

from jaxwillmore import equilibria


@pytest.mark.parametrize("v", [0.8])
def test_prolate_and_oblate_are_found_from_either(prolate, v):
    """At v = 0.8 the prolate is the minimum and the oblate a saddle with a higher energy."""
    found = equilibria.equilibria(
        prolate.mesh, prolate.x, reduced_volume=v, bending_modulus=0.7, n=2
    )
    energies = [float(shape.bending_over_8pi_kappa) for shape in found]
    # Of an axisymmetric spectral solver.
    np.testing.assert_allclose(energies, [1.387440432, 1.452538629], rtol=6e-4)
    assert [shape.negative_directions for shape in found] == [0, 2]


def test_no_shape_is_no_question(prolate):
    with pytest.raises(ValueError, match="at least 1"):
        equilibria.equilibria(prolate.mesh, prolate.x, n=0)

"""Surface diffusion keeps the volume and lowers the area."""

import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.flows import SurfaceDiffusion


@pytest.mark.slow
def test_ellipsoid_becomes_a_sphere_of_equal_volume():
    mesh, x = jw.mesh.ellipsoid(semi_axes=(1.0, 1.0, 1.4), level=1, degree=2)
    volume = float(jw.surface.volume(mesh, x))
    run = jw.evolve.evolve(SurfaceDiffusion(), mesh, x, t1=0.5)
    areas = [record["area"] for record in run.records]
    assert np.all(np.diff(areas) < 1e-6 * areas[0])
    assert run.records[-1]["reduced_volume"] > 0.999
    # Conservation holds up to the discretisation: no multiplier enforces it.
    np.testing.assert_allclose(run.records[-1]["volume"], volume, rtol=3e-3)


def test_mobility_is_checked():
    with pytest.raises(ValueError, match="`mobility` must be positive; got 0"):
        SurfaceDiffusion(0)

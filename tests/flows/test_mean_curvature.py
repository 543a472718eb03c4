"""Mean curvature flow and its kin: exact radii of spheres, and a law that is linear in H."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.fem import Jet, point
from jaxwillmore.flows import MeanCurvatureFlow

from .systems import equation


def inverse(H):
    return -1.0 / H


@pytest.mark.parametrize(
    "flow, t1, radius",
    [
        (MeanCurvatureFlow(), 0.1, np.sqrt(1 - 4 * 0.1)),  # R² = 1 - 4t
        pytest.param(
            MeanCurvatureFlow(inverse), 0.4, np.exp(0.4 / 2), marks=pytest.mark.slow
        ),  # R' = R/2
        pytest.param(
            MeanCurvatureFlow(lambda H: H**2),
            0.05,
            (1 - 12 * 0.05) ** (1 / 3),
            marks=pytest.mark.slow,
        ),  # R³ = 1 - 12t
    ],
    ids=["mean curvature", "inverse", "square"],
)
@pytest.mark.parametrize(
    "scheme", ["implicit", pytest.param("linearly-implicit", marks=pytest.mark.slow)]
)
def test_spheres_keep_their_law(flow, t1, radius, scheme):
    mesh, x = jw.mesh.icosphere(1, degree=2)
    run = jw.evolve.evolve(flow, mesh, x, t1=t1, rtol=2e-4, scheme=scheme)
    # The guard of the energy, here the area, knows which of the laws let it grow.
    assert (run.records[-1]["energy"] > run.records[0]["energy"]) == (radius > 1)
    R = np.sqrt(run.records[-1]["area"] / (4 * np.pi))
    assert abs(R - radius) < 4e-3 * abs(radius - 1) + 3e-4, (R, radius)


@pytest.mark.parametrize("H", [2.0, 2.5, 1.0])
def test_the_law_is_the_tangent_of_the_speed_at_the_frozen_curvature(H):
    """V + F(Ĥ) + F'(Ĥ)(H − Ĥ) with F = H³ and Ĥ = 2: the step by H stays implicit."""

    def scalar(value):
        return Jet(jnp.asarray(value), jnp.zeros(3))

    hat, trial = SimpleNamespace(H=scalar(2.0)), SimpleNamespace(H=scalar(H), V=scalar(0.7))
    nothing, here = SimpleNamespace(), point(jnp.zeros(3), jnp.eye(3)[:, :2])
    law = MeanCurvatureFlow(lambda H: H**3)
    found = equation(law, "V", here, nothing, hat, trial, nothing, scalar(0.5))
    np.testing.assert_allclose(found, (0.7 + 8.0 + 12.0 * (H - 2.0)) * 0.5, rtol=1e-14)

"""Surface diffusion keeps the volume and lowers the area."""

from types import SimpleNamespace

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore.fem import Jet, inner, point, trace
from jaxwillmore.flows import SurfaceDiffusion, WillmoreFlow

from .systems import equation


@pytest.mark.slow
def test_ellipsoid_becomes_a_sphere_of_equal_volume():
    mesh, x = jw.mesh.ellipsoid(semi_axes=(1.0, 1.0, 1.4), level=1, degree=2)
    volume = float(jw.surface.volume(mesh, x))
    run = jw.evolve.evolve(SurfaceDiffusion(), mesh, x, t1=0.5)
    areas = [record["area"] for record in run.records]
    assert np.all(np.diff(areas) < 1e-5 * areas[0])
    assert run.records[-1]["reduced_volume"] > 0.999
    # Conservation holds up to the discretisation: no multiplier enforces it.
    np.testing.assert_allclose(run.records[-1]["volume"], volume, rtol=3e-3)


def test_it_is_willmore_flow_without_its_lower_order_terms():
    """(10a)–(10d) with b = m and Q = 0: those of `WillmoreFlow` with b_b = m/2, less its force."""
    m, here, keys = 0.8, point(jnp.zeros(3), jnp.eye(3)[:, :2]), iter(jr.split(jr.key(0), 99))

    def jet(*shape):
        return Jet(
            jr.normal(next(keys), shape), jr.normal(next(keys), (*shape, 3)).at[..., 2].set(0)
        )

    jets, chi = (
        SimpleNamespace(H=jet(), V=jet(), nu=jet(3), z=jet(3)) for _ in ("coefficients", "tests")
    )
    data = SimpleNamespace(alpha=jet())
    rate = SimpleNamespace(H=jnp.asarray(0.4), nu=jr.normal(next(keys), (3,)))

    def of(law, name):
        return equation(law, name, here, rate, jets, jets, data, getattr(chi, name))

    willmore, law = WillmoreFlow(m / 2), SurfaceDiffusion(m)
    Q = willmore.force(jets)
    H, nu = jets.H.value, jets.nu.value
    pushed = Q * trace(chi.nu.grad) - Q * H * inner(nu, chi.nu.value)
    lost = {"H": 0.0, "V": Q * chi.V.value, "nu": pushed, "z": 0.0}
    for name, force in lost.items():
        np.testing.assert_allclose(of(law, name), of(willmore, name) + force, rtol=1e-12)


def test_the_coefficient_is_checked():
    with pytest.raises(ValueError, match="`mullins_coefficient` must be positive; got 0"):
        SurfaceDiffusion(0)

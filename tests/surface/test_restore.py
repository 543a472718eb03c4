"""Area and volume come back exactly, by a displacement as small as what is missing."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.energies import Willmore
from jaxwillmore.mesh import ellipsoid, icosphere, quality, remesh
from jaxwillmore.surface import area, restored, volume

MESH, X = ellipsoid((1.0, 1.0, 1.6), 2, 2)
A, V = float(area(MESH, X)), float(volume(MESH, X))


@pytest.mark.parametrize(
    "wanted", [{"area": A * 1.001}, {"volume": V * 0.998}, {"area": A * 1.001, "volume": V}]
)
def test_what_is_asked_for_is_there_and_the_surface_hardly_moved(wanted):
    x = restored(MESH, X, **wanted)
    for name, value in wanted.items():
        found = {"area": area, "volume": volume}[name](MESH, x)
        assert float(found) == pytest.approx(value, rel=1e-12)
    assert float(jnp.max(jnp.linalg.norm(x - X, axis=1))) < 0.02


@pytest.mark.parametrize("times", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_remeshings_keep_area_volume_and_energy(times):
    """642 nodes of degree 2: twenty times raise the energy by less than a thousandth in all."""
    mesh, x = MESH, X
    energies = [float(Willmore()(mesh, x))]
    for k in range(times):
        size = np.sqrt(4 / np.sqrt(3) * A / 320) * (1.02 if k % 2 else 0.98)
        new = remesh(mesh, x, size)
        mesh, x = new.mesh, restored(new.mesh, new.x, area=A, volume=V)
        energies.append(float(Willmore()(mesh, x)))
    assert float(area(mesh, x)) == pytest.approx(A, rel=1e-11)
    assert float(volume(mesh, x)) == pytest.approx(V, rel=1e-11)
    assert quality(mesh, x).min_angle > 35
    assert abs(max(energies) / energies[0] - 1) < 1e-3


def test_what_no_small_displacement_gives_is_refused():
    with pytest.raises(ValueError, match="another shape"):
        restored(MESH, X, volume=2 * V)
    with pytest.raises(ValueError, match="Give `area` or `volume`"):
        restored(MESH, X)
    with pytest.raises(ValueError, match="`area` must be positive"):
        restored(MESH, X, area=-1.0)
    mesh, x = icosphere(1, 2)
    with pytest.raises(ValueError, match="sphere one follows the other|another shape"):
        restored(mesh, x, area=float(area(mesh, x)) * 0.999, volume=float(volume(mesh, x)))

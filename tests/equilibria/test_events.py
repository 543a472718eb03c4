"""Bifurcations: found where the eigenvalue is zero, told apart, and a way to the other branch.

The oblate at H₀ = 0 meets the biaxial branch at v = 0.7497 (extrapolated from degree 4 on 2,562
nodes); below it is stable, above it has two negative directions, cos 2φ and sin 2φ.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import equilibria
from jaxwillmore.equilibria import _walk
from jaxwillmore.equilibria._events import _asymmetry, _soft
from jaxwillmore.equilibria._follow import Follower
from jaxwillmore.equilibria._stability import SecondVariation
from jaxwillmore.equilibria._symmetry import lost


def oblate(v, level=1, **kwargs):
    mesh, x = equilibria.spheroid(v, "oblate", level=level)
    return equilibria.equilibrium(mesh, x, reduced_volume=v, **kwargs)


@pytest.fixture(scope="module")
def crossed():
    """Oblates through the bifurcation, on 162 nodes."""
    return equilibria.branch(oblate(0.74), stop=0.77, max_step=0.02)


def test_a_disc_on_a_five_fold_mesh_has_pairs_of_modes(crossed):
    first = crossed.points[0]
    assert equilibria.symmetry(first.mesh, first.x).biaxiality < 1e-10
    np.testing.assert_allclose(first.eigenvalues[0], first.eigenvalues[1], rtol=1e-6)
    np.testing.assert_allclose(first.eigenvalues[2], first.eigenvalues[3], rtol=1e-6)


def test_the_pitchfork_of_the_disc_is_found(crossed):
    assert crossed.succeeded
    (event,) = crossed.events
    assert (event.kind, event.event, event.mode) == ("pitchfork", "bifurcation", "cos 2φ, even")
    assert event.negative_directions == (0, 2) and len(event.modes) == 2
    # 162 nodes of degree 2 find it 4e-3 too high, 642 of degree 4 within 1e-4.
    assert event.value == pytest.approx(0.7497, abs=6e-3)
    # The slope of the eigenvalue is -58: this is 1e-5 of the parameter.
    assert abs(event.shape.eigenvalues[0]) < 1e-3
    assert "pitchfork at reduced volume = 0.75" in event.words


def test_the_bifurcation_is_a_point_of_the_branch(crossed):
    (event,) = crossed.events
    row, shape = crossed.rows[event.point], crossed.points[event.point]
    assert row["event"] == "bifurcation"
    assert row["reduced_volume"] == pytest.approx(event.value, rel=1e-12)
    assert shape is event.shape
    assert [r["event"] for r in crossed.rows].count(None) == len(crossed.rows) - 1
    volumes = [r["reduced_volume"] for r in crossed.rows]
    assert volumes == sorted(volumes)
    assert crossed.table().splitlines()[0].endswith(",event")


def test_the_branch_that_crosses_is_biaxial_and_higher(crossed):
    """Below the bifurcation the disc is a minimum; the way out of it goes over a biaxial shape."""
    biaxial = equilibria.switch(crossed.events[0])
    v = float(biaxial.reduced_volume)
    assert 0.73 < v < crossed.events[0].value
    assert equilibria.symmetry(biaxial.mesh, biaxial.x).biaxiality > 0.1
    assert biaxial.negative_directions == 1
    assert float(biaxial.energy) > float(oblate(v, stability=False).energy)


def test_both_signs_of_the_mode_lead_to_the_same_shape(crossed):
    energies, volumes = [], []
    for amplitude in (0.1, -0.1):
        shape = equilibria.switch(crossed.events[0], amplitude=amplitude, stability=False)
        energies.append(float(shape.bending_over_8pi_kappa))
        volumes.append(float(shape.reduced_volume))
    # Turned by 90 degrees on a five-fold mesh: another mesh.
    np.testing.assert_allclose(volumes[0], volumes[1], atol=2e-5)
    np.testing.assert_allclose(energies[0], energies[1], atol=5e-5)


def test_a_point_that_cannot_be_found_is_told(crossed, monkeypatch):
    def lost(*arguments):
        raise ArithmeticError

    monkeypatch.setattr(_walk, "events_of", lost)
    with pytest.warns(RuntimeWarning, match="no solution was found in between"):
        found = equilibria.branch(crossed.points[0], stop=0.7, max_points=1)
    assert found.events == () and len(found.points) == 2


def test_switch_refuses(crossed):
    (event,) = crossed.events
    with pytest.raises(ValueError, match="2 soft modes"):
        equilibria.switch(event, 2)
    with pytest.raises(ValueError, match="other than 0"):
        equilibria.switch(event, amplitude=0.0)


@pytest.mark.parametrize(
    "harmonic, is_odd", [(lambda n: 3 * n[2] ** 2 - 1, False), (lambda n: n[0] * n[2], True)]
)
def test_a_mode_is_odd_where_its_cube_has_no_mean(harmonic, is_odd):
    """On a sphere ∫Y₂₀³ > 0, ∫Y₂₁³ = 0: a transcritical point and a pitchfork."""
    mesh, x = equilibria.spheroid(0.99, "oblate", level=1)
    n = x / jnp.linalg.norm(x, axis=1, keepdims=True)
    ball = equilibria.equilibrium(
        mesh,
        n,
        area=None,
        pressure=8.0,
        tension=4.0,
        tolerance=1e-8,
        stability=False,
        throw=False,
        search="stationary",
    )
    follower = Follower(ball, "pressure", 1e-8, "direct")
    here = follower.point
    system = follower.system(here.reference, follower.prescribed(here.p))
    v = system.pack(jnp.zeros(len(n)), here.y, here.g)
    variation = SecondVariation(system, v)
    mode = variation.completed(0.0, np.asarray(harmonic(n.T)))
    variation.release()
    asymmetry = float(_asymmetry(system, v, jnp.asarray(mode)))
    assert asymmetry < 1e-6 if is_odd else asymmetry > 100


@pytest.mark.slow
def test_oblates_reach_both_ends_without_a_jump():
    """From the sphere's neighbourhood to v = 0.55, through the pitchfork, the discs stay discs."""
    found = equilibria.branch(oblate(0.95, level=2), stop=0.55)
    assert found.succeeded
    assert [event.kind for event in found.events][:1] == ["pitchfork"]
    assert "fold" not in [event.kind for event in found.events]
    for shape in found.points:
        assert equilibria.symmetry(shape.mesh, shape.x).biaxiality < 1e-6
    by_volume = {round(float(p.reduced_volume), 4): p for p in found.points}
    assert float(by_volume[0.95].bending_over_8pi_kappa) == pytest.approx(1.10612, abs=2e-4)


@pytest.mark.slow
def test_the_disc_at_three_quarters_is_found_where_it_is_marginal():
    shape = oblate(0.75, level=2)
    assert float(shape.bending_over_8pi_kappa) == pytest.approx(1.574480117, rel=1e-4)
    assert shape.stats["lost"] == ()


def test_the_soft_modes_are_those_nearest_to_zero():
    """One of several negative ones, or a pair that is split by the mesh."""
    assert _soft(np.array([-9.0, -1e-4, 3.0])) == [1]
    assert _soft(np.array([-9.0, -2e-4, 1e-4, 3.0])) == [1, 2]
    assert _soft(np.array([2.0, 25.0, 31.0])) == [0]


def test_a_lost_symmetry_has_a_name():
    round_, flat = equilibria.Symmetry(1e-9, 1e-9), equilibria.Symmetry(0.2, 1e-9)
    assert lost(round_, flat) == ("body of revolution",)
    assert lost(flat, round_) == () and lost(flat, flat) == ()
    # What was none before cannot be lost, however far it goes.
    assert lost(equilibria.Symmetry(0.05, 1e-9), equilibria.Symmetry(0.9, 1e-9)) == ()

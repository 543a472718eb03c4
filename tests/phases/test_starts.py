"""Starts: the amount is exact, interfaces have their equilibrium profile, noise is repeatable."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import GinzburgLandau
from jaxwillmore.mesh import ellipsoid, icosphere, red_cell
from jaxwillmore.phases import amount, caps, domains, interface_length, resolution, spinodal, stripe
from jaxwillmore.surface import area

from ..helpers import random_rotation


def mean_of(mesh, x, c):
    return amount(mesh, x, c) / area(mesh, x)


@pytest.fixture(scope="module")
def sphere():
    return icosphere(2, 2)


@pytest.fixture(scope="module")
def prolate():
    return ellipsoid((1.0, 1.1, 1.8), 1, 2)


@pytest.mark.parametrize("mean", [0.15, 0.5, 0.8])
def test_the_amount_of_every_start_is_exact(prolate, mean):
    mesh, x = prolate
    for c in (
        spinodal(mesh, x, mean),
        stripe(mesh, x, 0.2, mean),
        caps(mesh, x, 0.2, mean),
        caps(mesh, x, 0.2, mean, 1),
    ):
        np.testing.assert_allclose(mean_of(mesh, x, c), mean, rtol=1e-14)


@pytest.mark.parametrize(
    "mean, width, least",
    [(0.5, 0.2, 6.1142370441), (0.5, 0.1, 6.2422775511), (0.25, 0.1, 5.3456008635)],
)
def test_a_stripe_on_a_sphere_is_close_to_the_least_energy(sphere, mean, width, least):
    """E/λ of the equilibrium by spectral elements.

    At x = ½ the profile differs from it by O(ℓ²), the distance from the arc by O(ℓ³), and the mesh
    adds 6e-4 (ℓ/h)⁻⁴. At x = ¼ the phases leave their wells by cot θ ℓ/6 in equilibrium, which
    costs a start from the wells (cot θ ℓ/6)² ζ/4 times the area over the energy.
    """
    mesh, x = sphere
    found = GinzburgLandau(1.0, width)(mesh, x, {"c": stripe(mesh, x, width, mean)}) / least - 1
    theta = np.arccos(1 - 2 * mean)
    bulk = (width / np.tan(theta) / 6) ** 2 * 3 / width * 4 * np.pi / least
    allowed = width**4 + 8e-4 * float(resolution(mesh, x, width)) ** -4 + bulk
    assert 0 < found < allowed, (float(found), allowed)


def test_a_stripe_has_the_profile_of_its_width(sphere):
    """c = 1/(1 + e^{−s/ℓ}) with the latitude s, up to the chord and the polygon for the line."""
    mesh, x = sphere
    c = stripe(mesh, x, 0.2)
    s = jnp.arcsin(jnp.clip(x[:, 2], -1.0, 1.0))
    near = jnp.abs(s) < 0.6
    expected = jnp.where(near, 1 / (1 + jnp.exp(-s / 0.2)), c)
    np.testing.assert_allclose(c, expected, atol=2.5e-3)


def test_a_stripe_crosses_the_longest_axis_however_the_body_is_turned(prolate):
    mesh, x = prolate
    R = random_rotation(jr.key(1))
    c, turned = stripe(mesh, x, 0.2), stripe(mesh, x @ R.T, 0.2)
    assert jnp.all((c > 0.9) <= (x[:, 2] > 0))
    # Up to which end is the upper one; 1 − c then has the mean ½ but for the rule of the area.
    flipped = turned if jnp.vdot(turned - 0.5, c - 0.5) > 0 else 1 - turned
    np.testing.assert_allclose(flipped, c, atol=2e-5)


def test_the_axis_may_be_given(sphere):
    mesh, x = sphere
    c = stripe(mesh, x, 0.2, 0.5, np.array([0.0, -2.0, 0.0]))
    assert jnp.all(jnp.where(x[:, 1] < -0.5, c > 0.9, True))
    with pytest.raises(ValueError, match="`axis` must be a vector of three numbers, not zero"):
        stripe(mesh, x, 0.2, axis=np.zeros(3))


def test_two_caps_have_two_edges_of_equal_length(sphere):
    """Each of the area 2π(1 − cos θ) = 0.2 · 4π: cos θ = 0.6, edges 2π · 0.8, to O((ℓ/sin θ)²)."""
    mesh, x = sphere
    c = caps(mesh, x, 0.1, 0.4)
    assert (domains(mesh, c), domains(mesh, 1 - c)) == (2, 1)
    np.testing.assert_allclose(
        interface_length(mesh, x, c), 2 * 2 * np.pi * 0.8, rtol=(0.1 / 0.8) ** 2
    )
    one = caps(mesh, x, 0.1, 0.2, 1)
    assert domains(mesh, one) == 1
    np.testing.assert_allclose(
        interface_length(mesh, x, one), 2 * np.pi * 0.8, rtol=(0.1 / 0.8) ** 2
    )


def test_a_cell_with_close_faces_gets_one_line_around_it():
    """The two faces of a red cell are near in space, but not across the line."""
    mesh, x = red_cell(1, 2)
    c = stripe(mesh, x, 0.35, 0.4)
    assert (domains(mesh, c), domains(mesh, 1 - c)) == (1, 1)
    assert 0 <= c.min() and c.max() <= 1


def test_noise_is_the_same_for_a_seed_and_bounded(prolate):
    mesh, x = prolate
    a, b, other = (spinodal(mesh, x, 0.4, 0.1, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(a, b)
    assert jnp.max(jnp.abs(a - other)) > 0.05
    # Uniform in ±0.1 but for the shift of the mean; the standard deviation is 0.1/√3.
    assert jnp.max(jnp.abs(a - 0.4)) < 0.11
    np.testing.assert_allclose(jnp.std(a), 0.1 / np.sqrt(3), rtol=0.1)


def test_the_generator_of_noise_does_not_depend_on_the_platform():
    """The first numbers of the generator for seed 0, before the shift."""
    mesh, x = icosphere(0, 2)
    c = spinodal(mesh, x, 0.5, 0.5, 0)
    first = np.array([0.6369616873214543, 0.2697867137638703, 0.04097352393619469])
    np.testing.assert_allclose(c[1:3] - c[0], first[1:] - first[0], rtol=1e-12)


def test_starts_without_meaning_are_refused(sphere):
    mesh, x = sphere
    for start in (stripe, caps):
        with pytest.raises(ValueError, match="`mean` must lie between 0 and 1"):
            start(mesh, x, 0.2, 1.2)
        with pytest.raises(ValueError, match="needs a width of at least 0.4 h"):
            start(mesh, x, 0.01, 0.5)
        with pytest.raises(ValueError, match="`mean` must lie between 0.0[0-9]* and"):
            start(mesh, x, 0.2, 1e-4)
    with pytest.raises(ValueError, match="`n` must be 1 or 2 caps; got 3"):
        caps(mesh, x, 0.2, 0.5, 3)
    with pytest.raises(ValueError, match="`mean` must lie between 0 and 1"):
        spinodal(mesh, x, 0.0)
    with pytest.raises(ValueError, match="`amplitude` must lie between 0 and 0.1, or c leaves"):
        spinodal(mesh, x, 0.1, 0.2)

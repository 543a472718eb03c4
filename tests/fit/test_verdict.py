"""Verdicts: noise is no misfit, a systematic distance is, another size is no match."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.fit import RESULTS
from jaxwillmore.fit._phase_verdict import judged_phases
from jaxwillmore.fit._targets import target
from jaxwillmore.fit._verdict import judged, judged_forces
from jaxwillmore.mesh import icosphere


@dataclasses.dataclass(frozen=True)
class Shape:
    """What a verdict looks at."""

    mesh: object
    x: object
    residual: np.ndarray
    distances: dict


KNOWN = {"reduced_volume": True, "scaled_spontaneous_curvature": True}


def verdict(field, *, size=1.0, noise=None, result=RESULTS.converged, known=KNOWN, others=()):
    """Of a unit sphere with these distances to a model of another size."""
    mesh, x = icosphere(3, degree=1)
    seen = target(mesh, x)
    d = np.asarray(field(np.asarray(x).T), float) * np.ones(len(x))
    numbers = {"rms": np.sqrt(np.mean(d**2)), "largest": np.abs(d).max(), "largest_back": 0.0}
    shape = Shape(mesh, size * x, d, numbers)
    return judged((seen,), (shape,), result, known, noise, others)


def white(n):
    return 0.02 * np.random.default_rng(3).standard_normal(n.shape[1])


def test_independent_errors_agree_whether_their_size_is_known_or_not():
    assert verdict(white).word == "agrees"
    assert verdict(white, noise=0.02).word == "agrees"
    assert (
        abs(verdict(white).evidence["correlation"]) < 0.1 and verdict(white).evidence["shared"] == 0
    )
    assert verdict(white, noise=0.02).evidence["chi_squared"] == pytest.approx(1.0, abs=0.1)


def test_errors_beyond_the_known_noise_are_a_misfit():
    found = verdict(white, noise=0.01)
    assert found.word == "misfit" and found.warnings == (found.sentence,)


def test_a_systematic_distance_is_a_misfit_without_any_noise_known():
    found = verdict(lambda n: 0.03 * (3 * n[2] ** 2 - 1))
    assert found.word == "misfit" and "no noise" in found.sentence
    assert found.evidence["correlation"] > 0.9
    # The same shape below what counts.
    assert verdict(lambda n: 0.003 * (3 * n[2] ** 2 - 1)).word == "agrees"


def test_a_systematic_distance_is_found_under_noise():
    assert verdict(lambda n: white(n) + 0.02 * (3 * n[2] ** 2 - 1)).word == "misfit"


def test_a_model_of_another_size_is_no_match():
    found = verdict(lambda n: 0.0 * n[0], size=1.31)
    assert found.word == "wrong size or pose" and "1.31 times" in found.sentence


def test_a_flat_direction_is_undetermined():
    found = verdict(white, known=KNOWN | {"scaled_spontaneous_curvature": False})
    assert found.word == "undetermined" and "scaled_spontaneous_curvature" in found.sentence
    assert verdict(white, result=RESULTS.on_bound).word == "undetermined"
    assert judged((), (), RESULTS.model_failed, KNOWN, None).word == "undetermined"


def test_an_unfinished_fit_and_a_rival_are_suspected():
    assert verdict(white, result=RESULTS.step_limit).word == "local minimum suspected"
    found = verdict(white, others=(("oblate", 1.01),))
    assert found.word == "local minimum suspected" and "oblate (1.01 times" in found.sentence
    assert verdict(white, others=(("oblate", 1.5),)).word == "agrees"


def test_forces():
    known = {"scaled_pressure": True}
    assert judged_forces(0.01, known).word == "agrees"
    assert judged_forces(0.4, known).word == "misfit"
    assert judged_forces(0.01, {"scaled_pressure": False}).word == "undetermined"


def interface(n, shift=0.0):
    """A concentration with one interface of width 0.3 about the equator."""
    return 1 / (1 + np.exp(-(np.asarray(n)[:, 2] - shift) / 0.3))


def of_phases(error=0.0, *, shift=0.0, size=1.0, noise=None, known=KNOWN):
    """Of a unit sphere with such a concentration beside a model of degree 2."""
    mesh, x = icosphere(3, degree=1)
    own, nodes = icosphere(2, degree=2)
    c, there = jnp.asarray(interface(x) + error), jnp.asarray(interface(nodes, shift))
    model = own, size * nodes, there
    return judged_phases(target(mesh, x), c, model, RESULTS.converged, known, noise)


C_NOISE = 0.02 * np.random.default_rng(4).standard_normal(642)


def test_two_phases_agree_within_noise_that_is_known_or_not():
    found = of_phases(C_NOISE)
    assert found.word == "agrees" and found.evidence["shared_c"] == 0
    assert found.evidence["rms_c"] == pytest.approx(0.02, rel=0.1)
    found = of_phases(C_NOISE, noise=(0.01, 0.02))
    assert found.word == "agrees"
    assert found.evidence["chi_squared_c"] == pytest.approx(1.0, abs=0.2)


def test_a_concentration_beyond_its_noise_is_a_misfit():
    found = of_phases(C_NOISE, noise=(0.01, 0.01))
    assert found.word == "misfit" and "concentration" in found.warnings[0]


def test_an_interface_elsewhere_is_a_misfit_on_the_right_shape():
    found = of_phases(C_NOISE, shift=0.1)
    assert found.word == "misfit" and "neighbouring points share" in found.sentence
    # Where it hardly moves nothing is said.
    assert of_phases(shift=0.01).word == "agrees"


def test_the_shape_of_two_phases_is_judged_first():
    assert of_phases(C_NOISE, shift=0.1, size=1.3).word == "wrong size or pose"
    assert of_phases(C_NOISE, known=KNOWN | {"line_tension": False}).word == "undetermined"
    assert of_phases(shift=0.1, known=KNOWN | {"line_tension": False}).word == "misfit"

"""Verdicts: noise is no misfit, a systematic distance is, another size is no match."""

import dataclasses

import numpy as np
import pytest

from jaxwillmore.fit import RESULTS
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


KNOWN = {"reduced_volume": True, "spontaneous_curvature": True}


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
    found = verdict(white, known=KNOWN | {"spontaneous_curvature": False})
    assert found.word == "undetermined" and "spontaneous_curvature" in found.sentence
    assert verdict(white, result=RESULTS.on_bound).word == "undetermined"
    assert judged((), (), RESULTS.model_failed, KNOWN, None).word == "undetermined"


def test_an_unfinished_fit_and_a_rival_are_suspected():
    assert verdict(white, result=RESULTS.step_limit).word == "local minimum suspected"
    found = verdict(white, others=(("oblate", 1.01),))
    assert found.word == "local minimum suspected" and "oblate (1.01 times" in found.sentence
    assert verdict(white, others=(("oblate", 1.5),)).word == "agrees"


def test_forces():
    known = {"pressure": True}
    assert judged_forces(0.01, known).word == "agrees"
    assert judged_forces(0.4, known).word == "misfit"
    assert judged_forces(0.01, {"pressure": False}).word == "undetermined"

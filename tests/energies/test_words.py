"""Energies as words: the same object comes back, or an error says why not."""

import json

import jax
import jax.numpy as jnp
import pytest

from jaxwillmore.energies import (
    AreaDifference,
    AreaPenalty,
    CanhamHelfrich,
    FloryHuggins,
    GinzburgLandau,
    Mixture,
    OsmoticPressure,
    Pressure,
    SurfaceTension,
    TwoPhase,
    VolumePenalty,
    Willmore,
    energy_of,
    words_of,
)

ENERGIES = {
    "sum": OsmoticPressure(3.5, 1.0, 1.0, 20.0) + 2 * AreaPenalty(0.1, 1 / 3) / 3,
    "sums of sums": 0.7 * sum([SurfaceTension(0.1), Pressure(-0.3)]) - VolumePenalty(1.0, 4.0),
    "area difference": AreaDifference(0.1, 2.0, 1e-3),
    "moduli": TwoPhase(Mixture(0.5, 1.0), 0.1, Mixture(0.0, 0.3), 4.0, 0.3),
    "mixing": TwoPhase(well=FloryHuggins(1.0, 3.0, 0.1)),
    "nodes": CanhamHelfrich(jnp.array([1.0, 2.0, 1 / 7])),
    "phase": GinzburgLandau(line_tension=1.0, interface_width=0.1),
}


@pytest.mark.parametrize("energy", ENERGIES.values(), ids=ENERGIES)
def test_an_energy_comes_back_from_its_words(energy):
    again = energy_of(json.loads(json.dumps(words_of(energy))))
    assert jax.tree.structure(again) == jax.tree.structure(energy)
    for one, other in zip(jax.tree.leaves(energy), jax.tree.leaves(again), strict=True):
        assert (one.dtype, one.weak_type) == (other.dtype, other.weak_type)
        assert jnp.all(one == other)


def test_functions_and_energies_of_others_have_no_words():
    with pytest.raises(TypeError, match="no functions; got a `ModulusFunction`.*give a `Mixture`"):
        words_of(TwoPhase(lambda c: 1 + c, line_tension=1.0, interface_width=0.1))
    with pytest.raises(TypeError, match="got a `Willmore`"):
        words_of(Pressure(1.0) + Willmore())


@pytest.mark.parametrize(
    "words, message",
    [
        ({"kind": "Pressure"}, "made of pressure_difference"),
        ({"kind": "Pressure", "pressure_difference": 1.0, "x": 1.0}, "got pressure_difference, x"),
        ({"kind": "Pressure", "pressure_difference": [1.0, 2.0]}, "one finite number"),
        ({"kind": "VolumePenalty", "strength": -1.0, "preferred_volume": 1.0}, "positive"),
        ({"kind": "eval"}, "is called 'eval'"),
        ({"kind": "sum", "terms": [], "factors": [1.0]}, "0 terms has 1 factors"),
        (
            {
                "kind": "sum",
                "terms": [{"kind": "Mixture", "at_zero": 1.0, "at_one": 2.0}],
                "factors": [1.0],
            },
            "not all energies",
        ),
    ],
)
def test_other_words_are_no_energy(words, message):
    with pytest.raises(ValueError, match=message):
        energy_of(words)

"""Energies as words and numbers that JSON can say, and back."""

from typing import Any

import numpy as np

from ._base import AbstractEnergy, Combination
from ._canham_helfrich import PARAMETERS, CanhamHelfrich
from ._global import (
    AreaDifference,
    AreaPenalty,
    OsmoticPressure,
    Pressure,
    SurfaceTension,
    VolumePenalty,
)
from ._mixture import Mixture
from ._phase import GinzburgLandau
from ._two_phase import TwoPhase
from ._wells import FloryHuggins, QuarticWell

# Classes by name, with the arguments that make the same object again. Each is an attribute too.
_KINDS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "AreaDifference": (AreaDifference, ("nonlocal_modulus", "preferred_difference", "thickness")),
    "AreaPenalty": (AreaPenalty, ("stretching_modulus", "preferred_area")),
    "CanhamHelfrich": (CanhamHelfrich, PARAMETERS),
    "FloryHuggins": (
        FloryHuggins,
        ("entropy_coefficient", "interaction", "gradient_coefficient", "cutoff"),
    ),
    "GinzburgLandau": (GinzburgLandau, ("well",)),
    "Mixture": (Mixture, ("at_zero", "at_one")),
    "OsmoticPressure": (
        OsmoticPressure,
        (
            "solute_amount",
            "ambient_concentration",
            "temperature",
            "gas_constant",
            "vant_hoff_index",
        ),
    ),
    "Pressure": (Pressure, ("pressure_difference",)),
    "QuarticWell": (QuarticWell, ("line_tension", "interface_width")),
    "SurfaceTension": (SurfaceTension, ("surface_tension",)),
    "VolumePenalty": (VolumePenalty, ("strength", "preferred_volume")),
}
_NAMES = {kind: name for name, (kind, _) in _KINDS.items()}


def words_of(part: Any) -> dict[str, Any]:
    """An energy, a well or a modulus as a dictionary; every digit is in it.

    **Raises:** `TypeError` for one that is not of this package, or holds a function.
    """
    kind = type(part)
    if kind is Combination:
        terms = [words_of(term) for term in part.terms]
        return {"kind": "sum", "factors": [_word(f) for f in part.factors], "terms": terms}
    if kind is TwoPhase:
        parameters = {name: _word(value) for name, value in part.bending_parameters.items()}
        return {"kind": "TwoPhase", **parameters, "well": words_of(part.well)}
    if kind not in _NAMES:
        raise TypeError(
            f"a file holds energies, wells and moduli of this package, and no functions; got a "
            f"`{kind.__name__}`. In place of a function of the concentration give a `Mixture`"
        )
    names = _KINDS[_NAMES[kind]][1]
    return {"kind": _NAMES[kind], **{name: _word(getattr(part, name)) for name in names}}


def energy_of(words: dict[str, Any]) -> Any:
    """What `words_of` was given: an object of the same class with the same numbers.

    **Raises:** `KeyError`, `TypeError` or `ValueError` where these are no words of it, or name
    parameters that its class refuses.
    """
    rest = {name: value for name, value in words.items() if name != "kind"}
    kind = words["kind"]
    if kind == "sum":
        terms, factors = [energy_of(term) for term in rest["terms"]], rest["factors"]
        if len(terms) != len(factors):
            raise ValueError(f"a sum of {len(terms)} terms has {len(factors)} factors")
        if not all(isinstance(term, AbstractEnergy) for term in terms):
            raise ValueError("the terms of a sum are not all energies")
        return Combination(terms, [np.asarray(factor) for factor in factors])
    known = {"TwoPhase": (TwoPhase, (*PARAMETERS, "well"))} | _KINDS
    if kind not in known:
        raise ValueError(f"no energy, well or modulus is called {kind!r:.80}")
    make, names = known[kind]
    if set(rest) != set(names):
        raise ValueError(f"{kind} is made of {', '.join(names)}; got {', '.join(rest):.80}")
    return make(**{name: _value(value) for name, value in rest.items()})


def _word(value: Any) -> Any:
    """Numbers as they are, arrays as lists, and everything else by its own words."""
    try:
        array = np.asarray(value)
    except TypeError:
        return words_of(value)
    return array.tolist() if array.dtype.kind == "f" else words_of(value)


def _value(word: Any) -> Any:
    return energy_of(word) if isinstance(word, dict) else np.asarray(word)

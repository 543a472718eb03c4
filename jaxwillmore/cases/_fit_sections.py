"""The sections of the case file of a fit."""

import dataclasses
import typing
from typing import ClassVar

from ..fit import FORCE_PARAMETERS, SHAPE_PARAMETERS
from ._error import CaseError
from ._keys import check_keys, declare
from ._rules import Rule, choice, flag, integer, number, optional, refused, rising, text
from ._sections import OF_FAIRING, SMOOTHINGS, check_smoothing

MATCH, BALANCE, SERIES = METHODS = ("match", "force-balance", "series")
# The section in which a method has its model.
MODEL_SECTIONS = {MATCH: "model", SERIES: "flow"}
FLOW_PARAMETERS = ("bending_modulus", "spontaneous_curvature", "tension", "pressure")
# What each method knows, what it finds unless asked for less, and what targets share.
PARAMETERS = {MATCH: SHAPE_PARAMETERS, BALANCE: FORCE_PARAMETERS, SERIES: FLOW_PARAMETERS}
USUALLY_FREE = {
    MATCH: ("reduced_volume", "scaled_spontaneous_curvature"),
    BALANCE: FORCE_PARAMETERS,
    SERIES: ("bending_modulus",),
}
USUALLY_SHARED = {
    MATCH: ("scaled_spontaneous_curvature",),
    BALANCE: ("spontaneous_curvature",),
    SERIES: (),
}


def _texts(meaning: str, *words: str) -> Rule:
    """A text, or a list of texts; with `words`, of these only."""

    def convert(value):
        many = (value,) if isinstance(value, str) else value
        if not isinstance(many, list | tuple) or not all(isinstance(w, str) and w for w in many):
            raise TypeError
        if len(set(many)) != len(many) or (words and not set(many) <= set(words)):
            raise ValueError
        return tuple(many)

    listed = ", ".join(f'"{word}"' for word in words)
    return Rule(f"a list of {listed}" if words else "text in quotes, or a list", convert, meaning)


_ANY = dict.fromkeys(name for names in PARAMETERS.values() for name in names)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class TargetCase:
    """What was observed."""

    name: ClassVar[str] = "target"

    file: tuple[str, ...] = declare(_texts("meshes: .ply .off .obj .stl .npz, or example:NAME.npz"))
    times: tuple[float, ...] | None = declare(
        optional(rising("when each file was seen, in a series")), None
    )
    start: str | None = declare(
        optional(text("mesh at time 0; left out, a series starts at its first file")), None
    )
    same_mesh: bool = declare(flag("refuse a series whose files have different triangles"), True)
    fix_orientation: bool = declare(flag("turn triangles so that normals point out"), False)
    smooth: str | None = declare(
        optional(choice("by spherical harmonics (no handles), or without waves", *SMOOTHINGS)), None
    )
    wavelength: float | None = declare(optional(number(OF_FAIRING, above=0.0)), None)

    def __post_init__(self):
        check_keys(self)
        check_smoothing(self)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class ModelCase:
    """The equilibria that are fitted, and where they start.

    A parameter that is not free is held at its value here. Left out, the reduced volume is that
    of each target.
    """

    name: ClassVar[str] = "model"

    kind: str = declare(
        choice("family of shapes to start in", "prolate", "oblate", "stomatocyte", "several"),
        "prolate",
    )
    level: int = declare(integer("refinement: 1, 2, 3 for 162, 642, 2562 nodes", 1, 5), 2)
    reduced_volume: float | None = declare(
        optional(number("start or held value", above=0.2, below=1.0)), None
    )
    scaled_spontaneous_curvature: float = declare(number("start or held value"), 0.0)
    scaled_pressure: float | None = declare(optional(number("where it is free")), None)

    def __post_init__(self):
        check_keys(self)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class FlowModelCase:
    """The flow that is fitted to a series, and where its parameters start.

    A parameter that is not free is held at its value here. Units are those of lengths and times in
    the files, for a mobility of 1.
    """

    name: ClassVar[str] = "flow"

    bending_modulus: float = declare(number("start or held value", above=0.0), 0.5)
    spontaneous_curvature: float = declare(number("start or held value"), 0.0)
    tension: float = declare(number("start or held value"), 0.0)
    pressure: float = declare(number("inside minus outside, start or held value"), 0.0)
    hold: tuple[str, ...] = declare(_texts("kept as at the start", "area", "volume"), ())
    tangential: str = declare(
        choice("how nodes slide along the surface", "minimal-deformation", "none"),
        "minimal-deformation",
    )

    def __post_init__(self):
        check_keys(self)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class FitCase:
    """How they are fitted; `free` and `shared` are those usual for the method if left out."""

    name: ClassVar[str] = "fit"

    method: str = declare(
        choice("by the distance of surfaces, by forces alone, or by motion", *METHODS), MATCH
    )
    free: tuple[str, ...] = declare(
        optional(_texts("parameters to find; the others are held", *_ANY)), None
    )
    shared: tuple[str, ...] = declare(optional(_texts("the same for all targets", *_ANY)), None)
    reduced_volume_bounds: tuple[float, float] | None = declare(
        optional(rising("allowed range", 2)), None
    )
    scaled_spontaneous_curvature_bounds: tuple[float, float] | None = declare(
        optional(rising("allowed range of H₀R₀", 2)), None
    )
    spontaneous_curvature_bounds: tuple[float, float] | None = declare(
        optional(rising("allowed range of H₀, 1/length, in a series", 2)), None
    )
    distance: str = declare(
        choice("of points, or of harmonics of a star-shaped radius", "points", "harmonics"),
        "points",
    )
    max_degree: int = declare(integer("largest degree of the harmonics", 2, 30), 12)
    both_ways: bool = declare(flag("of points: also from the model to the target"), True)
    noise: float | None = declare(
        optional(number("standard deviation of the nodes of the target", above=0.0)), None
    )
    rtol: float = declare(number("error of a time step, in a series", above=0.0, below=1.0), 1e-4)
    tolerance: float = declare(number("of unknowns and residuals", above=0.0), 1e-7)
    max_steps: int = declare(integer("stop after as many steps", 1), 100)
    picture: bool = declare(flag("draw overlay, residual and profile"), True)

    def __post_init__(self):
        check_keys(self)
        for key, usual in (("free", USUALLY_FREE), ("shared", USUALLY_SHARED)):
            if getattr(self, key) is None:
                object.__setattr__(self, key, usual[self.method])
        self._check_names("free", 1)
        self._check_names("shared", 0)
        self._refuse_what_does_not_apply()

    def _check_names(self, key: str, least: int) -> None:
        """Each method has parameters of its own."""
        given, known = getattr(self, key), PARAMETERS[self.method]
        if len(given) < least or not set(given) <= set(known):
            listed = ", ".join(f'"{word}"' for word in known)
            allowed = f'a list of {listed} with method = "{self.method}"'
            raise refused(self.name, key, list(given), allowed)

    def _refuse_what_does_not_apply(self):
        """A key without effect would be a wrong answer to whoever wrote it."""
        for field in dataclasses.fields(self):
            methods = _APPLIES.get(field.name)
            unset = (None, ()) if field.default is None else (field.default,)
            if methods and self.method not in methods and getattr(self, field.name) not in unset:
                allowed = " or ".join(f'"{method}"' for method in methods)
                problem = f'is for method = {allowed}; this fit has method = "{self.method}".'
                raise CaseError(problem, section=self.name, key=field.name)


_APPLIES = {
    "shared": (MATCH, BALANCE),
    "reduced_volume_bounds": (MATCH,),
    "scaled_spontaneous_curvature_bounds": (MATCH,),
    "spontaneous_curvature_bounds": (SERIES,),
    "distance": (MATCH,),
    "max_degree": (MATCH,),
    "both_ways": (MATCH,),
    "rtol": (SERIES,),
}

"""The sections of a case as frozen dataclasses: every key with its default, range and meaning.

`no_type_check` keeps checkers of annotations away at run time: the rules below convert and check
every value, and their messages are the ones a user should see.
"""

import dataclasses
import math
import typing
from collections.abc import Mapping
from typing import Any, ClassVar

from ..shapes import SHAPES, shape_parameters
from ._error import CaseError, shown, suggestion
from ._keys import check_keys, declare, entries, key_names, unknown_key
from ._laws import LAWS
from ._rules import (
    Rule,
    apply,
    choice,
    flag,
    integer,
    number,
    numbers_like,
    optional,
    refused,
    text,
)

_MAX_FRAMES = 100_000
_OF_FILES = (
    *("merge_tolerance", "fix_orientation", "repair", "keep", "components", "genus"),
    *("smooth", "wavelength"),
)
HARMONICS, FAIRING = SMOOTHINGS = ("harmonics", "fairing")
OF_FAIRING = "of the waves that fairing halves; left out, it follows from the noise"


def check_smoothing(section) -> None:
    """A wavelength without effect would be a wrong answer to whoever wrote it."""
    if section.wavelength is not None and section.smooth != FAIRING:
        problem = f'has an effect with smooth = "{FAIRING}" only.'
        got = section.wavelength
        raise CaseError(problem, section=section.name, key="wavelength", got=got)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class SurfaceCase:
    """Where the surface comes from: the name of a generator in `shape`, or a mesh in `file`.

    `parameters` are the keyword arguments of the generator; in a case file they stand in
    `[surface]` like all other keys. Left out, `level` is 2 for a shape and for harmonics, and 0 for
    other files.
    """

    name: ClassVar[str] = "surface"

    shape: str | None = declare(optional(text("generator; `jaxwillmore shapes` lists them")), None)
    file: str | None = declare(optional(text("mesh: .ply .off .obj .stl .npz .vtu")), None)
    level: int | None = declare(optional(integer("uniform refinements", 0, 7)), None)
    degree: int = declare(integer("polynomial degree of the triangles", 1, 4), 2)
    merge_tolerance: float | None = declare(
        optional(number("file only: vertices closer than this are one", at_least=0.0)), None
    )
    fix_orientation: bool = declare(
        flag("file only: turn triangles so that normals point out"), False
    )
    repair: bool = declare(
        flag("file only: drop collapsed and repeated faces and unused vertices, turn normals out"),
        False,
    )
    keep: str | None = declare(
        optional(choice("file only: keep so many of the largest pieces", "largest")), None
    )
    components: int = declare(integer("file only: how many separate pieces there are", 1), 1)
    genus: int | None = declare(
        optional(integer("file only: refuse another number of handles", 0)), None
    )
    smooth: str | None = declare(
        optional(
            choice("file only: by spherical harmonics (no handles), or without waves", *SMOOTHINGS)
        ),
        None,
    )
    wavelength: float | None = declare(optional(number(OF_FAIRING, above=0.0)), None)
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        check_keys(self)
        if (self.shape is None) == (self.file is None):
            both = "both are given" if self.shape is not None else "neither is given"
            raise CaseError(f"needs either `shape` or `file`; {both}.", section=self.name)
        if self.level is None:
            made = self.file is None or self.smooth == HARMONICS
            object.__setattr__(self, "level", 2 if made else 0)
        check_smoothing(self)
        if self.smooth is not None and self.components != 1:
            problem = f"is for surfaces of one piece; components = {self.components}."
            raise CaseError(problem, section=self.name, key="smooth", got=self.smooth)
        given = dict(self.parameters)
        if self.shape is None:
            if given:
                raise unknown_key(self.name, next(iter(given)), key_names(self))
        else:
            given = self._shape_parameters(self.shape, given)
        object.__setattr__(self, "parameters", given)

    def _shape_parameters(self, shape: str, given: dict[str, Any]) -> dict[str, Any]:
        if shape not in SHAPES:
            known = ", ".join(SHAPES)
            hint = suggestion(shape, SHAPES)
            problem = f"no shape is called {shown(shape)}.{hint} Known shapes: {known}."
            raise CaseError(problem, section=self.name, key="shape", got=shape, allowed=known)
        for field in dataclasses.fields(self):
            key = field.name
            if key in _OF_FILES and getattr(self, key) != field.default:
                problem = "is for meshes from a file; leave it out together with `shape`."
                raise CaseError(problem, section=self.name, key=key, got=getattr(self, key))
        defaults = shape_parameters(shape)
        for key in given:
            if key not in defaults:
                raise unknown_key(self.name, key, [*key_names(self), *defaults])
        complete = {**defaults, **given}
        return {
            key: apply(_parameter_rule(defaults[key]), self.name, key, value)
            for key, value in complete.items()
        }

    def entries(self) -> list[tuple[str, object, str]]:
        """What a case file says in `[surface]`; keys for files only are left out with a shape."""
        skip = () if self.shape is None else _OF_FILES
        own = [entry for entry in entries(self) if entry[0] not in skip]
        meanings = {} if self.shape is None else SHAPES[self.shape].parameters
        return own + [(key, value, meanings[key].meaning) for key, value in self.parameters.items()]


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class FlowCase:
    """The flow and how it is advanced in time."""

    name: ClassVar[str] = "flow"

    kind: str = declare(
        choice(
            "willmore (Canham–Helfrich where H0 is not 0), another law, or a surface at rest",
            *LAWS,
            "phase",
        ),
        "willmore",
    )
    scheme: str = declare(
        choice("Newton in every step, or one linear solve", "implicit", "linearly-implicit"),
        "implicit",
    )
    bdf_order: int = declare(integer("order in time; 5 is fragile", 1, 5), 2)
    tangential: str = declare(
        choice("how nodes move along the surface", "minimal-deformation", "none"),
        "minimal-deformation",
    )
    consistency: float = declare(
        number("c of the consistency terms c·|A|⁴; 4 to 8 holds, 0 switches off", at_least=0.0), 6.0
    )
    consistency_weight: str = declare(
        choice("c times the largest |A|⁴, or node by node", "global", "local"), "global"
    )

    def __post_init__(self):
        check_keys(self)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class TimeCase:
    """From when to when, and how carefully. The unit of time is length⁴ / energy.

    Left out, `dt0` is 1e-5 of R⁴ / (2 b_b) with the area 4πR². The velocity scale of
    `stop_when_stationary` is 2 b_b / R³.
    """

    name: ClassVar[str] = "time"

    t0: float = declare(number("start"), 0.0)
    t1: float = declare(number("end"))
    dt0: float | None = declare(
        optional(number("first step; left out, it follows from the size", above=0.0)), None
    )
    rtol: float = declare(
        number("error per step relative to the extent; it decides the steps", above=0.0, below=1.0),
        1e-3,
    )
    stop_when_stationary: float = declare(
        number("stop below this part of the velocity scale; 0: never", at_least=0.0), 1e-6
    )
    self_contact: bool = declare(flag("stop where triangles pierce each other"), False)
    max_steps: int = declare(integer("stop after as many steps", 1), 10_000)

    def __post_init__(self):
        check_keys(self)
        if not self.t1 > self.t0:
            allowed = f"a finite number > t0 = {self.t0:g}"
            raise refused(self.name, "t1", self.t1, allowed)
        if self.dt0 is not None and not self.dt0 <= self.t1 - self.t0:
            allowed = f"a finite number > 0 and <= t1 - t0 = {self.t1 - self.t0:g}"
            raise refused(self.name, "dt0", self.dt0, allowed)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class OutputCase:
    """What is left besides tables, final state and summary, and what ends a run early."""

    name: ClassVar[str] = "output"

    every: float | None = declare(optional(number("time between frames", above=0.0)), None)
    frames: bool = declare(flag("write frames/*.vtu and run.pvd for ParaView"), True)
    picture: bool = declare(flag("draw final.png, and history.png or branch.png"), True)
    self_intersection: bool = declare(
        flag("look for triangles that pierce each other in the last shape"), False
    )
    fatal_warnings: bool = declare(
        flag("end as `unhealthy` at the first warning under `health` in summary.json"), False
    )
    checkpoint_minutes: float = declare(
        number("time on the clock between checkpoints; they cost at most 2 %", above=0.0), 1.0
    )
    checkpoint_steps: int | None = declare(
        optional(integer("also a checkpoint after as many steps, whatever it costs", 1)), None
    )

    def __post_init__(self):
        check_keys(self)

    def within(self, time: TimeCase | None) -> "OutputCase":
        """The same with `every` checked against the time interval, or chosen: a fiftieth of it."""
        if time is None:
            return self
        interval = time.t1 - time.t0
        if self.every is None:
            return dataclasses.replace(self, every=interval / 50)
        if not interval / _MAX_FRAMES <= self.every <= interval:
            allowed = f"a finite number from {interval / _MAX_FRAMES:g} to t1 - t0 = {interval:g}"
            raise refused(self.name, "every", self.every, allowed)
        return self


OF_PHASES = ("mean", "line_tension", "interface_width")
SEARCHES = ("minimum", "stationary")
BRANCH_PARAMETERS = ("reduced_volume", "spontaneous_curvature", "pressure", *OF_PHASES)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class EquilibriumCase:
    """How an equilibrium is searched, alone or as the start of a branch."""

    name: ClassVar[str] = "equilibrium"

    search: str = declare(
        choice("downhill all the way, or by Newton's method even to a saddle", *SEARCHES),
        "minimum",
    )

    def __post_init__(self):
        check_keys(self)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class BranchCase:
    """A family of equilibria along a parameter. Steps are changes of the parameter."""

    name: ClassVar[str] = "branch"

    parameter: str = declare(
        choice("what is followed; the last three with [phase]", *BRANCH_PARAMETERS),
        "reduced_volume",
    )
    stop: float = declare(number("where the branch ends, in the unit of the parameter"))
    step0: float | None = declare(
        optional(number("first step; left out, it follows from the parameter", above=0.0)), None
    )
    max_step: float | None = declare(optional(number("largest step", above=0.0)), None)
    min_step: float | None = declare(
        optional(number("smallest step; a branch that needs less ends", above=0.0)), None
    )
    max_points: int = declare(integer("most points after the start", 1, 10_000), 100)
    self_contact: bool = declare(flag("stop where triangles pierce each other"), False)

    def __post_init__(self):
        check_keys(self)
        if self.parameter == "reduced_volume" and not 0 < self.stop <= 1:
            raise refused(self.name, "stop", self.stop, "a reduced volume: > 0 and <= 1")
        if self.parameter == "mean" and not 0 < self.stop < 1:
            raise refused(self.name, "stop", self.stop, "a mean concentration: > 0 and < 1")
        if self.parameter in OF_PHASES and not self.stop > 0:
            raise refused(self.name, "stop", self.stop, f"a {self.parameter}: > 0")
        for name in ("step0", "max_step"):
            larger = getattr(self, name)
            if self.min_step is not None and larger is not None and self.min_step > larger:
                allowed = f"a finite number > 0 and <= {name} = {larger:g}"
                raise refused(self.name, "min_step", self.min_step, allowed)


def _parameter_rule(default: object) -> Rule:
    """What a parameter of a shape may hold, by what its default holds."""
    if isinstance(default, tuple):
        return numbers_like(default)
    if default is None:
        return optional(integer("", 3))
    if isinstance(default, int):
        return integer("", 1)
    return number("", at_least=-math.inf)

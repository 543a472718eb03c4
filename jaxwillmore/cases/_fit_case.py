"""The case file of a fit: sections, keys, and how they are read."""

import dataclasses
import os
import pathlib
import typing
from collections.abc import Mapping
from typing import Any, ClassVar

from ._error import CaseError, shown, suggestion
from ._examples import example_path, is_example
from ._keys import check_keys, declare, entries, key_names, unknown_key
from ._load import _content, _parsed
from ._rules import Rule, choice, flag, integer, number, optional
from ._toml import emit


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


def _pair(meaning: str) -> Rule:
    """Two numbers in order."""

    def convert(value):
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise TypeError
        low, high = (float(v) for v in value)
        if not low < high:
            raise ValueError
        return low, high

    return Rule("a list of two rising numbers", convert, meaning)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class TargetCase:
    """What was observed."""

    name: ClassVar[str] = "target"

    file: tuple[str, ...] = declare(_texts("meshes: .ply .off .obj .stl .npz, or example:NAME.npz"))
    fix_orientation: bool = declare(flag("turn triangles so that normals point out"), False)

    def __post_init__(self):
        check_keys(self)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class ModelCase:
    """The equilibria that are fitted, and where they start.

    A parameter that is not free is held at its value here. Left out, the reduced volume is that
    of each target.
    """

    name: ClassVar[str] = "model"

    kind: str = declare(choice("family of shapes to start in", "prolate", "oblate"), "prolate")
    level: int = declare(integer("refinement: 1, 2, 3 for 162, 642, 2562 nodes", 1, 5), 2)
    reduced_volume: float | None = declare(
        optional(number("start or held value", above=0.2, below=1.0)), None
    )
    spontaneous_curvature: float = declare(number("H0 R0, start or held value"), 0.0)
    pressure: float | None = declare(optional(number("P R0^3/kappa, where it is free")), None)

    def __post_init__(self):
        check_keys(self)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class FitCase:
    """How they are fitted."""

    name: ClassVar[str] = "fit"

    method: str = declare(
        choice("by the distance of surfaces, or by forces alone", "match", "force-balance"), "match"
    )
    free: tuple[str, ...] = declare(
        _texts("parameters to find", "reduced_volume", "spontaneous_curvature", "pressure"),
        ("reduced_volume", "spontaneous_curvature"),
    )
    shared: tuple[str, ...] = declare(
        _texts("the same for all targets", "reduced_volume", "spontaneous_curvature", "pressure"),
        ("spontaneous_curvature",),
    )
    reduced_volume_bounds: tuple[float, float] | None = declare(
        optional(_pair("allowed range")), None
    )
    spontaneous_curvature_bounds: tuple[float, float] | None = declare(
        optional(_pair("allowed range")), None
    )
    both_ways: bool = declare(flag("also from the model to the target"), False)
    noise: float | None = declare(
        optional(number("standard deviation of the nodes of the target", above=0.0)), None
    )
    tolerance: float = declare(number("of unknowns and residuals", above=0.0), 1e-7)
    max_steps: int = declare(integer("stop after as many steps", 1), 100)
    picture: bool = declare(flag("draw overlay, residual and profile"), True)

    def __post_init__(self):
        check_keys(self)


FIT_SECTIONS = {kind.name: kind for kind in (TargetCase, ModelCase, FitCase)}


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class FitTask:
    """Targets, a model and how to fit it; complete with defaults."""

    target: TargetCase
    model: ModelCase = ModelCase()
    fit: FitCase = FitCase()

    def to_toml(self) -> str:
        """A case file with every key; reading it gives this task again."""
        return emit({name: entries(getattr(self, name)) for name in FIT_SECTIONS})


def load_fit(source: str | os.PathLike[str] | Mapping[str, Any]) -> FitTask:
    """Read and check the case of a fit: a TOML file, `example:NAME`, TOML text, or tables.

    **Raises:** `CaseError` naming file, section, key, the value got and what is allowed.
    """
    if isinstance(source, Mapping):
        return _task(source, pathlib.Path())
    source = os.fspath(source)
    is_text = "\n" in source
    path = example_path(source) if is_example(source) else pathlib.Path("" if is_text else source)
    try:
        return _task(_parsed(source if is_text else _content(path)), path.parent)
    except CaseError as error:
        raise error.in_file("case text" if is_text else str(path)) from None


def _task(tables: Mapping[str, Any], folder: pathlib.Path) -> FitTask:
    sections: dict[str, Any] = {}
    for name, table in tables.items():
        if name not in FIT_SECTIONS:
            known = ", ".join(FIT_SECTIONS)
            hint = suggestion(name, FIT_SECTIONS)
            problem = f"unknown section.{hint} The sections of a fit: {known}."
            raise CaseError(problem, section=name, allowed=known)
        if not isinstance(table, Mapping):
            problem = f"must be a table: a line [{name}] with its keys below; got {shown(table)}."
            raise CaseError(problem, section=name, got=table)
        kind = FIT_SECTIONS[name]
        for key in table:
            if key not in key_names(kind):
                raise unknown_key(name, key, key_names(kind))
        sections[name] = dict(table)
    if "file" not in sections.get("target", {}):
        problem = "is missing; it must be text in quotes, or a list."
        raise CaseError(problem, section="target", key="file")
    made: dict[str, Any] = {name: FIT_SECTIONS[name](**t) for name, t in sections.items()}
    task = FitTask(**made)
    files = tuple(f if is_example(f) else os.path.abspath(folder / f) for f in task.target.file)
    return dataclasses.replace(task, target=dataclasses.replace(task.target, file=files))

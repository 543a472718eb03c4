"""The case file of a fit, and how it is read."""

import dataclasses
import os
import pathlib
import typing
from collections.abc import Mapping
from typing import Any

from ._error import CaseError, shown, suggestion
from ._examples import example_path, is_example
from ._fit_sections import MODEL_SECTIONS, SERIES, FitCase, FlowModelCase, ModelCase, TargetCase
from ._keys import entries, key_names, unknown_key
from ._load import _content, _parsed
from ._toml import emit

FIT_SECTIONS = {kind.name: kind for kind in (TargetCase, ModelCase, FlowModelCase, FitCase)}


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class FitTask:
    """Targets, a model and how to fit it; complete with defaults.

    A series has a `flow`, a match a `model`, a balance of forces neither.

    **Raises:** `CaseError` for sections and keys that contradict each other.
    """

    target: TargetCase
    model: ModelCase = ModelCase()
    flow: FlowModelCase = FlowModelCase()
    fit: FitCase = FitCase()

    def __post_init__(self):
        method = self.fit.method
        for other, section in MODEL_SECTIONS.items():
            if method != other and getattr(self, section) != FIT_SECTIONS[section]():
                problem = f'is for method = "{other}"; this fit has method = "{method}".'
                raise CaseError(problem, section=section)
        _check_times(self.target, method == SERIES)
        for held, multiplier in (("area", "tension"), ("volume", "pressure")):
            if held in self.flow.hold and (
                multiplier in self.fit.free or getattr(self.flow, multiplier)
            ):
                problem = f"has {held!r}: the {multiplier} follows and can be neither free nor set."
                raise CaseError(problem, section="flow", key="hold")

    def to_toml(self) -> str:
        """A case file with every key; reading it gives this task again."""
        own = MODEL_SECTIONS.get(self.fit.method)
        names = [name for name in ("target", own, "fit") if name is not None]
        return emit({name: entries(getattr(self, name)) for name in names})


def _check_times(target: TargetCase, of_flow: bool) -> None:
    """Times for every file of a series, and a surface before the first that is compared."""
    if not of_flow:
        for key in ("times", "start"):
            if getattr(target, key) is not None:
                problem = 'is for a time series: write method = "series" in [fit].'
                raise CaseError(problem, section="target", key=key)
        return
    files, times = len(target.file), target.times
    if times is None:
        problem = "is missing; a series needs the time at which each file was seen."
        raise CaseError(problem, section="target", key="times")
    if len(times) != files:
        problem = f"has {len(times)} times for {files} files."
        raise CaseError(problem, section="target", key="times")
    if target.start is None and files < 2:
        problem = "has one surface; a series needs a later one, or a `start` at time 0."
        raise CaseError(problem, section="target", key="file")
    if target.start is not None and times[0] <= 0:
        problem = f"must be after 0, the time of `start`; got {times[0]:g} first."
        raise CaseError(problem, section="target", key="times")


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
    place = lambda f: f if f is None or is_example(f) else os.path.abspath(folder / f)
    target = task.target
    placed = {"file": tuple(map(place, target.file)), "start": place(target.start)}
    return dataclasses.replace(task, target=dataclasses.replace(target, **placed))

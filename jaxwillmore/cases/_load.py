"""From a case file to a `Case`."""

import dataclasses
import os
import pathlib
import tomllib
from collections.abc import Mapping
from typing import Any, Literal

from ..io import wide_encoding
from ..shapes import SHAPES
from ._case import SECTIONS, Case
from ._error import CaseError, is_nearly, shown, suggestion
from ._examples import example_path, is_example
from ._keys import key_names, unknown_key
from ._phase_section import MODULI, PhaseCase
from ._sections import SurfaceCase

_MAX_BYTES = 2**20
_NEEDED = {"run": ("surface", "time"), "equilibrium": ("surface",), "branch": ("surface", "branch")}


def load_case(
    source: str | os.PathLike[str] | Mapping[str, Any],
    command: Literal["run", "equilibrium", "branch"] = "run",
) -> Case:
    """Read and check a case.

    **Arguments:**

    - `source`: the path of a TOML file; `example:NAME` for one that comes with the package; TOML
      text (anything with a line break in it); or the tables themselves. Where the surface is a
      mesh file, its path is relative to the folder of the case file.
    - `command`: what the case is for: `"run"` needs a section `[time]`, `"branch"` a section
      `[branch]`.

    **Raises:** `CaseError` naming file, section, key, the value got and what is allowed.

    ```python
    case = load_case("[surface]\\nshape = 'torus'\\n[time]\\nt1 = 1.0")
    ```
    """
    if isinstance(source, Mapping):
        return _case(source, pathlib.Path(), command)
    source = os.fspath(source)
    is_text = "\n" in source
    path = example_path(source) if is_example(source) else pathlib.Path("" if is_text else source)
    try:
        return _case(_parsed(source if is_text else _content(path)), path.parent, command)
    except CaseError as error:
        raise error.in_file("case text" if is_text else str(path)) from None


def _content(path: pathlib.Path) -> str:
    try:
        with open(path, "rb") as file:
            data = file.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise CaseError(f"is larger than {_MAX_BYTES} bytes; this is not a case file.")
        encoding = wide_encoding(data)
        if encoding is not None:
            raise CaseError(f"is text in {encoding}; save it as UTF-8.")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CaseError(f"is not a text file in UTF-8 (byte {error.start}).") from None
    except OSError as error:
        raise CaseError(f"cannot be read: {error.strerror or error}.") from None
    except ValueError as error:  # a NUL in the name of the file
        if isinstance(error, CaseError):
            raise
        raise CaseError(f"cannot be read: {error}.") from None


def _parsed(content: str) -> dict[str, Any]:
    try:
        # TOML allows CRLF; the parser wants it normalised, as reading in text mode does.
        return tomllib.loads(content.replace("\r\n", "\n"))
    except (ValueError, RecursionError) as error:  # Python's own for numbers of too many digits
        raise CaseError(f"is not valid TOML: {error!s:.200}.") from None


def _case(tables: Mapping[str, Any], folder: pathlib.Path, command: str) -> Case:
    for name, table in tables.items():
        if name not in SECTIONS or "." in name:
            raise _unknown_section(name, table)
        _check_table(name, table)
    for name in _NEEDED[command]:
        if name not in tables:
            raise CaseError(f"the section [{name}] is missing.", section=name)
    _check_moduli(tables)
    sections: dict[str, Any] = {
        name: _section(name, table, folder) for name, table in tables.items()
    }
    return Case(**sections)


def _check_moduli(tables: Mapping[str, Any]) -> None:
    """With [phase] the moduli stand there, and not in [energy] too."""
    for key in MODULI:
        if "phase" in tables and key in tables.get("energy", {}):
            problem = f"belongs into [phase] where there is one: {key} = [at c = 0, at c = 1]."
            raise CaseError(problem, section="energy", key=key, got=tables["energy"][key])


def _check_table(name: str, table: object) -> None:
    if not isinstance(table, Mapping):
        problem = f"must be a table: a line [{name}] with its keys below; got {shown(table)}."
        raise CaseError(problem, section=name, got=table)


def _section(name: str, table: Mapping[str, Any], folder: pathlib.Path):
    kind = SECTIONS[name]
    if kind is SurfaceCase:
        return _surface(dict(table), folder)
    known = key_names(kind)
    # Sections below this one: [energy.osmotic] is the key `osmotic` of [energy].
    below = [full.removeprefix(f"{name}.") for full in SECTIONS if full.startswith(f"{name}.")]
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key in below:
            _check_table(f"{name}.{key}", value)
            values[key] = _section(f"{name}.{key}", value, folder)
        elif key in known:
            values[key] = value
        else:
            elsewhere = None if is_nearly(key, known) else _misplaced(name, key)
            raise elsewhere or unknown_key(name, key, known + below)
    for field in dataclasses.fields(kind):
        if field.default is dataclasses.MISSING and field.name not in table:
            allowed = field.metadata["rule"].allowed
            problem = f"is missing; it must be {allowed}."
            raise CaseError(problem, section=name, key=field.name, allowed=allowed)
    file = values.get("file")
    if kind is PhaseCase and isinstance(file, str) and file:
        values["file"] = os.path.abspath(folder / file)
    return kind(**values)


def _surface(table: dict[str, Any], folder: pathlib.Path) -> SurfaceCase:
    own = key_names(SurfaceCase)
    parameters = {key: value for key, value in table.items() if key not in own}
    shape = table.get("shape")
    spec = SHAPES.get(shape) if isinstance(shape, str) else None
    own_of_shape = {} if spec is None else spec.parameters
    for key in parameters:
        if key not in own_of_shape and (misplaced := _misplaced("surface", key)):
            raise misplaced
    given = {key: value for key, value in table.items() if key in own}
    file = given.get("file")
    if isinstance(file, str) and file and not is_example(file):
        given["file"] = os.path.abspath(folder / file)
    return SurfaceCase(**given, parameters=parameters)


def _misplaced(section: str, key: str) -> CaseError | None:
    """The error for a key that belongs elsewhere, if it does."""
    for name, kind in SECTIONS.items():
        if name != section and key in key_names(kind):
            problem = f"unknown key; `{key}` belongs to [{name}]."
            return CaseError(problem, section=section, key=key)
    return None


def _unknown_section(name: str, table: object) -> CaseError:
    if not isinstance(table, Mapping) and (home := _misplaced("", name)):
        return CaseError(f"the key `{name}` stands before any section; {home.problem[13:]}")
    if name == "target":
        problem = "belongs to the case of a fit: `jaxwillmore fit` reads it."
        return CaseError(problem, section=name)
    known = [section for section in SECTIONS if "." not in section]
    hint = suggestion(name, known)
    problem = f"unknown section.{hint} Known sections: {', '.join(known)}."
    return CaseError(problem, section=name, allowed=", ".join(known))

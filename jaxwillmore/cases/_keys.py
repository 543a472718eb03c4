"""How the keys of a section are declared, checked, listed and refused."""

import dataclasses
from typing import Any

from ._error import CaseError, suggestion
from ._quantities import described
from ._rules import Rule, apply


def declare(rule: Rule, default: Any = dataclasses.MISSING) -> Any:
    """A key of a section with what it may hold; without a default it must be given."""
    if default is dataclasses.MISSING:
        return dataclasses.field(metadata={"rule": rule})
    return dataclasses.field(default=default, metadata={"rule": rule})


def declare_section(kind: type) -> Any:
    """A section below this one, which may be left out."""
    return dataclasses.field(default=None, metadata={"section": kind})


def sections_below(kind) -> dict[str, Any]:
    """The sections below a section, by the keys under which it holds them."""
    return {
        field.name: field.metadata["section"]
        for field in dataclasses.fields(kind)
        if "section" in field.metadata
    }


def check_keys(section) -> None:
    """Put every key into its final type, or raise `CaseError`."""
    for field in _fields(section):
        value = apply(
            field.metadata["rule"], section.name, field.name, getattr(section, field.name)
        )
        object.__setattr__(section, field.name, value)


def key_names(kind) -> list[str]:
    """The keys of a section; for the surface, those that every shape has."""
    return [field.name for field in _fields(kind)]


def _fields(section) -> list[dataclasses.Field]:
    return [field for field in dataclasses.fields(section) if "rule" in field.metadata]


def entries(section) -> list[tuple[str, object, str]]:
    """Keys, values and meanings of a section, in the order in which a case file has them."""
    rules = {field.name: field.metadata["rule"] for field in _fields(section)}
    return [
        (key, getattr(section, key), described(key, rule.meaning)) for key, rule in rules.items()
    ]


def unknown_key(section: str, key: str, known: list[str]) -> CaseError:
    """The error for a key that the section does not have."""
    problem = f"unknown key.{suggestion(key, known)} Known keys: {', '.join(known)}."
    return CaseError(problem, section=section, key=key, allowed=", ".join(known))


def values(section) -> dict[str, Any]:
    """Keys and values of a section."""
    return {field.name: getattr(section, field.name) for field in _fields(section)}

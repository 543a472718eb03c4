"""What a key of a case may hold: the check, and the words for it."""

import dataclasses
import itertools
import math
import numbers
from collections.abc import Callable

from ._error import CaseError, shown, suggestion


@dataclasses.dataclass(frozen=True)
class Rule:
    """`convert` returns the value in its final type, or raises `TypeError` or `ValueError`."""

    allowed: str
    convert: Callable[[object], object]
    meaning: str = ""


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError
    try:
        x = float(value)
    except OverflowError:
        raise ValueError from None
    if not math.isfinite(x):
        raise ValueError
    return x


def _integer(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise TypeError
    return int(value)


def number(
    meaning: str,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    below: float = math.inf,
    at_most: float = math.inf,
) -> Rule:
    """A finite number, strictly `above` and `below`, or `at_least` and `at_most` some bound."""

    def convert(value):
        x = _number(value)
        if not (above < x < below and at_least <= x <= at_most):
            raise ValueError
        return x

    bounds = [f"> {above:g}"] * (above > -math.inf) + [f">= {at_least:g}"] * (at_least > -math.inf)
    bounds += [f"< {below:g}"] * (below < math.inf)
    bounds += [f"<= {at_most:g}"] * (at_most < math.inf)
    return Rule(" ".join(["a finite number", " and ".join(bounds)]).strip(), convert, meaning)


def integer(meaning: str, low: int, high: int | None = None) -> Rule:
    """A whole number from `low` to `high`."""

    def convert(value):
        n = _integer(value)
        if n < low or (high is not None and n > high):
            raise ValueError
        return n

    words = f"a whole number >= {low}" if high is None else f"a whole number from {low} to {high}"
    return Rule(words, convert, meaning)


def numbers_like(default: tuple[float, ...]) -> Rule:
    """A list of as many finite numbers as `default` has."""

    def convert(value):
        if not isinstance(value, list | tuple):
            raise TypeError
        if len(value) != len(default):
            raise ValueError
        return tuple(_number(entry) for entry in value)

    return Rule(f"a list of {len(default)} finite numbers", convert)


def pair(meaning: str, **bounds: float) -> Rule:
    """Two numbers as in `number`, or one that stands for both."""
    rule = number(meaning, **bounds)

    def convert(value):
        values = value if isinstance(value, list | tuple) else (value, value)
        if len(values) != 2:
            raise ValueError
        return tuple(rule.convert(entry) for entry in values)

    return Rule(f"{rule.allowed}, or a list of two", convert, meaning)


def rising(meaning: str, count: int | None = None) -> Rule:
    """A list of rising finite numbers; `count` of them, or any number but none."""

    def convert(value):
        if not isinstance(value, list | tuple):
            raise TypeError
        many = tuple(_number(entry) for entry in value)
        wrong_count = not many if count is None else len(many) != count
        if wrong_count or any(a >= b for a, b in itertools.pairwise(many)):
            raise ValueError
        return many

    return Rule(f"a list of {'' if count is None else f'{count} '}rising numbers", convert, meaning)


def choice(meaning: str, *words: str) -> Rule:
    """One of a few words."""

    def convert(value):
        if not isinstance(value, str):
            raise TypeError
        if value not in words:
            raise ValueError
        return value

    return Rule("one of " + ", ".join(f'"{word}"' for word in words), convert, meaning)


def number_or(meaning: str, word: str, **bounds: float) -> Rule:
    """A number as in `number`, or one word."""
    rule = number(meaning, **bounds)

    def convert(value):
        return word if value == word else rule.convert(value)

    return Rule(f'{rule.allowed}, or "{word}"', convert, meaning)


def flag(meaning: str) -> Rule:
    """`true` or `false`."""

    def convert(value):
        if not isinstance(value, bool):
            raise TypeError
        return value

    return Rule("true or false", convert, meaning)


def text(meaning: str) -> Rule:
    """Text that is not empty."""

    def convert(value):
        if not isinstance(value, str):
            raise TypeError
        if not value or "\0" in value:
            raise ValueError
        return value

    return Rule("text in quotes", convert, meaning)


def optional(rule: Rule) -> Rule:
    """The same, or not given at all."""
    return dataclasses.replace(rule, convert=lambda v: None if v is None else rule.convert(v))


def apply(rule: Rule, section: str, key: str, value: object) -> object:
    """The value of one key in its final type; `CaseError` when the rule refuses it."""
    try:
        return rule.convert(value)
    except (TypeError, ValueError):
        raise refused(section, key, value, rule.allowed) from None


def refused(section: str, key: str, got: object, allowed: str) -> CaseError:
    """The error for a value outside what is allowed, with a hint for the usual slips."""
    hint = ""
    if isinstance(got, str) and "quotes" not in allowed:
        if allowed.startswith("one of"):
            hint = suggestion(got, allowed.removeprefix("one of ").replace('"', "").split(", "))
        elif _reads_as_value(got):
            hint = " Write it without quotes."
        elif _reads_as_value(got.replace(",", ".")):
            hint = " Write it without quotes and with a decimal point."
    elif isinstance(got, float) and got.is_integer() and allowed.startswith("a whole number"):
        hint = f" Write {int(got)} without a decimal point."
    problem = f"must be {allowed}; got {shown(got)}.{hint}"
    return CaseError(problem, section=section, key=key, got=got, allowed=allowed)


def _reads_as_value(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return word in ("true", "false")
    return True

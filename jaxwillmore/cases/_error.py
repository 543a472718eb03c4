"""The one exception a wrong case raises."""

import difflib
from collections.abc import Iterable


class CaseError(ValueError):
    """A case that cannot be run: says which file, section and key, what it got, what is allowed."""

    def __init__(
        self,
        problem: str,
        *,
        file: str | None = None,
        section: str | None = None,
        key: str | None = None,
        got: object = None,
        allowed: str | None = None,
    ):
        self.problem, self.file, self.section, self.key = problem, file, section, key
        self.got, self.allowed = got, allowed
        place = " ".join(part for part in (section and f"[{section}]", key) if part)
        super().__init__(": ".join(part for part in (file, place, problem) if part))

    def in_file(self, file: str) -> "CaseError":
        """The same error, naming the file it was found in."""
        where = {"section": self.section, "key": self.key, "got": self.got, "allowed": self.allowed}
        return CaseError(self.problem, file=file, **where)


def shown(value: object) -> str:
    """`value` as an error message shows it: short, on one line."""
    text = repr(value).lower() if isinstance(value, bool) else " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."


def is_nearly(word: str, known: Iterable[str]) -> bool:
    """Whether a word is most likely a slip for one of the known ones."""
    return bool(difflib.get_close_matches(word, list(known), n=1, cutoff=0.9))


def suggestion(word: str, known: Iterable[str]) -> str:
    """` Did you mean …?` for the nearest known word, or nothing."""
    nearest = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f" Did you mean `{nearest[0]}`?" if nearest else ""

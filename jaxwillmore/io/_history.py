"""The history of a run: one line of numbers per accepted step."""

import csv
import dataclasses
import io
import os
import pathlib
from typing import Any

from ._atomic import atomic_write
from ._links import unlinked
from ._plain import plain


def _word(value: Any) -> str:
    """A number with all its digits; NaN and None as `nan` and nothing."""
    value = plain(value)
    if value is None:
        return ""
    if isinstance(value, (dict, list)):
        raise TypeError(f"a history holds numbers and words; got {value!r:.80}")
    return repr(value) if isinstance(value, float) else str(value)


def _value(word: str) -> Any:
    if word == "":
        return None
    if word in ("True", "False"):
        return word == "True"
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


def _line(words: list[str]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(words)
    return buffer.getvalue()


def _complete_lines(path: pathlib.Path) -> list[str]:
    """The lines of the file, without a last one that a kill cut short."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return text[: text.rfind("\n") + 1].splitlines(keepends=True)


def read_history(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """The rows of a `history.csv`, numbers as numbers, exactly as they were written.

    A last line cut short by a kill is left out.

    **Raises:** `ValueError` naming the line when a row does not have the columns of the header.
    """
    lines = _complete_lines(pathlib.Path(path))
    if not lines:
        return []
    header, *rows = csv.reader(lines, strict=False)
    for number, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise ValueError(
                f"`{path}`, line {number}: {len(row)} values under {len(header)} columns."
            )
    return [dict(zip(header, map(_value, row), strict=True)) for row in rows]


@dataclasses.dataclass(frozen=True)
class History:
    """A CSV file that grows by one line at a time; the first row decides the columns.

    Every line is handed to the operating system at once, so a kill costs at most the line being
    written. Numbers keep all their digits.
    """

    path: str | os.PathLike[str]

    def append(self, row: dict[str, Any]) -> None:
        """Add one row.

        **Raises:** `ValueError` when the keys are not the columns of the file; `OSError` where it
        is a symbolic link, or the disk is full.
        """
        path = pathlib.Path(self.path)
        try:
            with open(path, encoding="utf-8", newline="", opener=unlinked) as file:
                header = next(csv.reader(file), [])
        except FileNotFoundError:
            header = []
        columns = header or list(row)
        if set(columns) != set(row):
            missing, extra = sorted(set(columns) - set(row)), sorted(set(row) - set(columns))
            raise ValueError(
                f"this row does not fit the columns of `{path}`: missing {missing}, new {extra}."
            )
        lines = [] if header else [_line(columns)]
        lines.append(_line([_word(row[column]) for column in columns]))
        with open(path, "a", encoding="utf-8", newline="", opener=unlinked) as file:
            file.write("".join(lines))

    def keep(self, count: int) -> None:
        """Keep the first rows only, without a torn last line, as a run that goes on must.

        **Raises:** `ValueError` where there are fewer.
        """
        path = pathlib.Path(self.path)
        lines = _complete_lines(path) if path.exists() else []
        found = max(len(lines) - 1, 0)
        if found < count:
            raise ValueError(f"`{path}` holds {found} rows; {count} were written.")
        if path.exists():
            with atomic_write(path, "w") as file:
                file.writelines(lines[: count + 1] if count else [])

    def sync(self) -> None:
        """Make what has been added survive a power cut."""
        with open(self.path, "ab", opener=unlinked) as file:
            os.fsync(file.fileno())

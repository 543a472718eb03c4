"""A finished table of numbers as a CSV file."""

import os
from collections.abc import Sequence
from typing import Any

from ._atomic import atomic_write
from ._history import _line, _word


def write_table(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write rows as CSV with all digits, replacing the file at once.

    Columns are all the keys, in the order in which they first appear; a row that lacks one leaves
    it empty. `read_history` reads the file.
    """
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with atomic_write(path, "w") as file:
        file.write(_line(columns))
        file.writelines(_line([_word(row.get(column)) for column in columns]) for row in rows)

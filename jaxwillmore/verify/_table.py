"""Tables of numbers as aligned text."""

import math
from collections.abc import Mapping, Sequence


def format_table(rows: Sequence[Mapping], columns: Mapping[str, str] | Sequence[str]) -> str:
    """Rows as text, one line each, numbers aligned to the right.

    **Arguments:**

    - `columns`: keys of the rows in order; with a mapping, its values are the headings.
    """
    headings = dict(columns) if isinstance(columns, Mapping) else {c: c for c in columns}
    cells = [list(headings.values())]
    cells += [[_text(row.get(key)) for key in headings] for row in rows]
    widths = [max(len(line[k]) for line in cells) for k in range(len(headings))]
    return "\n".join(
        "  ".join(text.rjust(width) for text, width in zip(line, widths, strict=True))
        for line in cells
    )


def _text(value) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool | str | int):
        return str(value)
    if value == 0:
        return "0"
    return f"{value:.2f}" if 0.1 <= abs(value) < 1000 else f"{value:.2e}"

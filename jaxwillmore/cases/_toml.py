"""Writing TOML: the standard library reads it only."""

import json
from collections.abc import Mapping, Sequence


def emit(tables: Mapping[str, Sequence[tuple[str, object, str]]]) -> str:
    """TOML text of `{table: [(key, value, comment), ...]}`; `None` is a remark.

    Reading the text back gives the same values: floats are written with all their digits.
    """
    blocks = []
    for table, entries in tables.items():
        lines = [f"[{table}]"]
        for key, value, comment in entries:
            line = f"# {key} is not set" if value is None else f"{key} = {_value(value)}"
            lines.append(f"{line:<34}  # {comment}" if comment else line)
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        # JSON's escapes are TOML's, except that TOML also forbids a bare DEL and has no surrogates.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    raise TypeError(f"TOML has no way to write {type(value).__name__}; got {value!r}.")

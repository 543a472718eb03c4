"""The last iterate of a fit, which it resumes from."""

import json
from typing import Any

from ..cases import CaseError
from ..io import RunFolder, atomic_write

ITERATE = "iterate.json"


def write_iterate(folder: RunFolder, tables: dict[str, Any]) -> None:
    """Replace `iterate.json`."""
    with atomic_write(folder.file(ITERATE), "w") as file:
        json.dump(tables, file)


def read_iterate(folder: RunFolder, read):
    """What `read` makes of the tables in `iterate.json`.

    **Raises:** `CaseError` where there is none, or `read` raises `ValueError`.
    """
    path = folder.path / ITERATE
    try:
        return read(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        words = "does not exist. Start it again with --replace in place of --resume."
        raise CaseError(f"there is no fit to resume: `{path}` {words}") from None
    except (ValueError, RecursionError) as error:
        raise CaseError(f"`{path}` cannot be read: {error}") from error

"""Files that are either the old one or the new one, never half of each."""

import contextlib
import os
import pathlib
import secrets
from collections.abc import Iterator
from typing import IO, Any, Literal

TEMPORARY = ".jaxwillmore-"
"""How the names of unfinished files begin; a killed run may leave one behind."""


def sync_folder(folder: pathlib.Path) -> None:
    """Make a rename inside `folder` survive a power cut, where the system can do that."""
    if os.name == "nt":
        return  # Windows has no handles of folders to flush
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:
        pass  # some network file systems refuse; the file itself is already safe
    finally:
        os.close(handle)


@contextlib.contextmanager
def atomic_write(
    path: str | os.PathLike[str], mode: Literal["w", "wb"] = "wb"
) -> Iterator[IO[Any]]:
    """Open a file for writing that replaces `path` only when everything has been written.

    The content goes to a temporary file in the same folder, is flushed to the disk and then
    renamed. Whatever fails before that (a full disk, an exception inside the `with` block, a kill)
    leaves the previous file as it was; except for a kill, the temporary file is removed. A symbolic
    link at `path` is replaced, not followed.

    **Arguments:**

    - `path`: the file to write; its folder must exist.
    - `mode`: `"w"` for text (UTF-8, line ends as given) or `"wb"` for bytes.

    **Raises:** `OSError` with the name of the file and the reason.

    ```python
    with atomic_write("summary.json", "w") as file:
        file.write("{}")
    ```
    """
    path = pathlib.Path(path)
    temporary = path.with_name(f"{TEMPORARY}{os.getpid()}-{secrets.token_hex(4)}.tmp")
    encoding, newline = ("utf-8", "") if mode == "w" else (None, None)
    try:
        # mode 0o666 is cut by the user's umask, as for any file
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        with os.fdopen(handle, mode, encoding=encoding, newline=newline) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        if isinstance(error, OSError):
            reason = error.strerror or str(error)
            message = f"cannot write `{path}`: {reason}; what was there before is unchanged"
            raise type(error)(error.errno, message) from error
        raise
    sync_folder(path.parent)


def remove_temporaries(folder: pathlib.Path) -> None:
    """Delete what killed writers left in `folder`; nobody else may be writing there."""
    for leftover in folder.glob(f"{TEMPORARY}*.tmp"):
        leftover.unlink(missing_ok=True)

"""Symbolic links in a folder of ours are not followed: what they point to is not ours."""

import errno
import os


def refuse_link(path: str | os.PathLike[str]) -> None:
    """**Raises:** `OSError` naming `path` where it is a symbolic link."""
    if os.path.islink(path):
        reason = "is a symbolic link, and these are not followed; remove it"
        raise OSError(errno.ELOOP, reason, os.fspath(path))


def unlinked(path: str | os.PathLike[str], flags: int) -> int:
    """An opener for `open` that fails on a symbolic link, also on one made a moment ago."""
    refuse_link(path)
    # Windows has no such flag, and its links need rights that other users do not have.
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)

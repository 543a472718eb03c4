"""The memory of this machine, and the refusal of what is larger."""

import os
import pathlib

# A limit set for the container, in its two versions.
LIMITS = "/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"


def machine_memory() -> int | None:
    """Bytes that a process may use at most; `None` where the system does not tell."""
    found = []
    try:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        pass
    for name in LIMITS:
        try:
            found.append(int(pathlib.Path(name).read_text()))
        except (ValueError, OSError):  # no such file, or "max"
            continue
    return min((size for size in found if size > 0), default=None)


def gigabytes(size: int) -> str:
    """A number of bytes in words, to about two digits."""
    return f"{size / 1e9:,.{1 if size < 1e10 else 0}f} GB"


def checked_memory(needed: int, what: str) -> int:
    """The memory that something needs, if this machine has so much.

    **Raises:** `ValueError` otherwise, with both numbers.
    """
    available = machine_memory()
    if available is not None and needed > available:
        raise ValueError(
            f"{what} would need about {gigabytes(needed)} of memory, and this machine has "
            f"{gigabytes(available)}. Use a coarser mesh (a level less needs a quarter), or a "
            "larger machine."
        )
    return needed

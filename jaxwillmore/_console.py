"""What a command says. It may get lost; what is computed goes on all the same."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def lasting_output() -> Iterator[None]:
    """Standard output and error that never fail, whoever closes them and however full the disk.

    After the first line that cannot be written no other is tried.
    """
    _occupy_closed()
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_Lasting(stream) for stream in before)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = before


class _Lasting(io.TextIOBase):
    """A text stream that swallows what another one cannot take."""

    def __init__(self, stream: Any):
        self._stream = stream
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without ρ must not end a run

    def write(self, text: str, /) -> int:
        with self._lost_at_worst():
            if self._stream is not None:
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._lost_at_worst():
            if self._stream is not None:
                self._stream.flush()

    def isatty(self) -> bool:
        try:
            return self._stream is not None and self._stream.isatty()
        except ValueError:  # closed
            return False

    def fileno(self) -> int:
        if self._stream is None:
            raise io.UnsupportedOperation("fileno")
        return self._stream.fileno()

    def writable(self) -> bool:
        return True

    @contextlib.contextmanager
    def _lost_at_worst(self):
        try:
            yield
        except (OSError, ValueError):  # a full disk, a reader that went away; a closed stream
            # What still waits in its buffer must have somewhere to go when the process ends.
            with contextlib.suppress(OSError, ValueError):
                _discard(self.fileno())
            self._stream = None


def _discard(number: int) -> None:
    """Let everything that is written to a file number vanish."""
    handle = os.open(os.devnull, os.O_RDWR)
    os.dup2(handle, number)
    os.close(handle)


def _occupy_closed() -> None:
    """Give closed standard streams a file, or the next one that is opened would take their place.

    It would be a file of a run, and everything that is printed below Python would go there.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number is given out first.
            os.open(os.devnull, os.O_RDWR)

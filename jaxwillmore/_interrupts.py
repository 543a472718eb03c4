"""Ctrl-C and SIGTERM end a computation at its next safe point."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator

# Signals belong to the process, and so does what is known of them: the numbers of those that
# arrived in the outermost `catch_interrupts`, `None` outside of any.
_arrived: list[int] | None = None


def interrupted() -> bool:
    """Whether a signal has arrived in the `catch_interrupts` around; no where there is none."""
    return bool(_arrived)


@contextlib.contextmanager
def catch_interrupts() -> Iterator[Callable[[], bool]]:
    """Let Ctrl-C and SIGTERM set a flag that loops look at; also a decorator.

    The first signal only sets the flag; a second one acts as usual. Signals belong to the outermost
    of nested contexts: the inner ones share its flag, so that a command made of several loops ends
    as a whole. Outside the main thread signals cannot be caught, and are left alone.

    **Returns:** a context whose value is the function `interrupted`.
    """
    global _arrived
    if _arrived is not None or threading.current_thread() is not threading.main_thread():
        yield interrupted
        return
    arrived = _arrived = []
    previous = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}

    def remember(number, frame):
        del frame
        arrived.append(number)
        for s, handler in previous.items():
            signal.signal(s, handler)

    for s in previous:
        signal.signal(s, remember)
    try:
        yield interrupted
    finally:
        _arrived = None
        for s, handler in previous.items():
            signal.signal(s, handler)

"""Ctrl-C and SIGTERM end a run after the step in progress."""

import contextlib
import signal
import threading


@contextlib.contextmanager
def catch_interrupts():
    """Yield a function that tells whether an interrupt has arrived.

    The first signal only sets the flag; a second one acts as usual. Outside the main thread
    signals cannot be caught, and the function always answers no.
    """
    arrived: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    previous = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}

    def remember(number, frame):
        del frame
        arrived.append(number)
        for s, handler in previous.items():
            signal.signal(s, handler)

    for s in previous:
        signal.signal(s, remember)
    try:
        yield lambda: bool(arrived)
    finally:
        for s, handler in previous.items():
            signal.signal(s, handler)

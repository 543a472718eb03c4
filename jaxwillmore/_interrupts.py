"""Ctrl-C, SIGTERM and SIGHUP end a computation at its next safe point, and a command at once."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator

# Signals belong to the process, and so does what is known of them: the numbers of those that
# arrived in the outermost `catch_interrupts`, `None` outside of any.
_arrived: list[int] | None = None


def interrupted() -> bool:
    """Whether a signal has arrived in the `catch_interrupts` around; no where there is none."""
    return bool(_arrived)


def exit_status(number: int | None = None) -> int:
    """The status of a command that a signal ended, by default the first that has arrived.

    130 for Ctrl-C, and where none has; 143 for SIGTERM and SIGHUP, whose senders ask the same.
    """
    if number is None:
        number = _arrived[0] if _arrived else signal.SIGINT
    return 128 + (signal.SIGINT if number == signal.SIGINT else signal.SIGTERM)


def _handlers() -> dict[int, object]:
    """The signals that ask for an end, with what answers them now.

    Not those that are ignored, as after `nohup` and in the background, nor those that another
    language has taken; and none outside the main thread, where they cannot be caught.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    # Windows has no SIGHUP.
    names = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    found = {number: signal.getsignal(number) for number in names if number is not None}
    return {number: h for number, h in found.items() if h not in (signal.SIG_IGN, None)}


def answer_signals() -> dict[int, object]:
    """From now on a signal ends the process with one line and its exit status; the old answers.

    At once: an exception could be lost in a callback of a library, as while JAX is imported.
    """
    before = _handlers()
    for number in before:
        signal.signal(number, _end)
    return before


def _end(number, frame) -> None:
    del frame
    words = "interrupted" if number == signal.SIGINT else "ended by a signal"
    with contextlib.suppress(OSError):
        os.write(2, f"jaxwillmore: {words}\n".encode())
    os._exit(exit_status(number))


@contextlib.contextmanager
def signals_answered() -> Iterator[None]:
    """`answer_signals` for a while."""
    before = answer_signals()
    try:
        yield
    finally:
        _restore(before)


def _restore(handlers) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)


@contextlib.contextmanager
def catch_interrupts() -> Iterator[Callable[[], bool]]:
    """Let Ctrl-C, SIGTERM and SIGHUP set a flag that loops look at; also a decorator.

    The first signal only sets the flag; a second one acts as usual. Signals belong to the outermost
    of nested contexts: the inner ones share its flag, so that a command made of several loops ends
    as a whole. Outside the main thread signals cannot be caught, and are left alone; so are those
    that the process ignores.

    **Returns:** a context whose value is the function `interrupted`.
    """
    global _arrived
    if _arrived is not None or threading.current_thread() is not threading.main_thread():
        yield interrupted
        return
    arrived = _arrived = []
    previous = _handlers()

    def remember(number, frame):
        del frame
        arrived.append(number)
        _restore(previous)

    for number in previous:
        signal.signal(number, remember)
    try:
        yield interrupted
    finally:
        _arrived = None
        _restore(previous)

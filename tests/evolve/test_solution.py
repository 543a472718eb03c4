"""Stop reasons: every one has a name and a sentence; signals set a flag and are given back."""

import os
import signal
import threading

import pytest

from jaxwillmore.evolve import RESULTS, message, name_of
from jaxwillmore.evolve._interrupt import catch_interrupts

NAMES = (
    "reached_t1",
    "stationary",
    "step_too_small",
    "not_finite",
    "element_inverted",
    "energy_rising",
    "step_limit",
    "interrupted",
)


@pytest.mark.parametrize("name", NAMES)
def test_every_reason_has_a_name_and_a_sentence(name):
    result = getattr(RESULTS, name)
    assert name_of(result) == name
    assert message(result).endswith(".") and len(message(result)) > 20


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_sets_a_flag_and_the_second_acts(number):
    received = []
    before = signal.signal(number, lambda *_: received.append("old handler"))
    try:
        with catch_interrupts() as interrupted:
            assert not interrupted()
            os.kill(os.getpid(), number)
            assert interrupted() and received == []
            os.kill(os.getpid(), number)
            assert received == ["old handler"]
        os.kill(os.getpid(), number)
        assert len(received) == 2  # given back
    finally:
        signal.signal(number, before)


def test_outside_the_main_thread_signals_are_left_alone():
    answers = []

    def work():
        with catch_interrupts() as interrupted:
            answers.append(interrupted())

    handler = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert answers == [False] and signal.getsignal(signal.SIGINT) is handler

"""Signals: the first sets a flag for the whole command, the second acts, handlers come back."""

import os
import signal
import threading

import pytest

from jaxwillmore._interrupts import catch_interrupts, exit_status, interrupted, signals_answered

NUMBERS = [signal.SIGINT, signal.SIGTERM]
if os.name != "nt":
    NUMBERS.append(signal.SIGHUP)


@pytest.mark.parametrize("number", NUMBERS)
def test_the_first_signal_sets_a_flag_and_the_second_acts(number):
    received = []
    before = signal.signal(number, lambda *_: received.append("old handler"))
    try:
        with catch_interrupts() as arrived:
            assert not arrived()
            os.kill(os.getpid(), number)
            assert arrived() and received == []
            os.kill(os.getpid(), number)
            assert received == ["old handler"]
        os.kill(os.getpid(), number)
        assert len(received) == 2  # given back
    finally:
        signal.signal(number, before)


def test_a_signal_in_an_inner_loop_ends_the_outer_one():
    with catch_interrupts() as outer:
        with catch_interrupts() as inner:
            os.kill(os.getpid(), signal.SIGTERM)
            assert inner()
        assert outer() and interrupted()
        with catch_interrupts() as later:
            assert later()
    assert not interrupted()


def test_a_command_that_was_interrupted_leaves_nothing_to_the_next():
    @catch_interrupts()
    def command(number):
        before = interrupted()
        os.kill(os.getpid(), number)
        return before, interrupted()

    for number in (signal.SIGINT, signal.SIGTERM):
        assert command(number) == (False, True)
    assert not interrupted()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_without_a_context_ctrl_c_is_what_it_always_was():
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
    assert not interrupted()


def test_outside_the_main_thread_signals_are_left_alone():
    answers = []

    def work():
        with catch_interrupts() as arrived:
            answers.append(arrived())

    handler = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert answers == [False] and signal.getsignal(signal.SIGINT) is handler


@pytest.mark.parametrize("number", NUMBERS)
def test_the_status_of_a_command_says_which_signal_ended_it(number):
    assert exit_status() == 130
    with catch_interrupts():
        os.kill(os.getpid(), number)
        assert exit_status() == (130 if number == signal.SIGINT else 143)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_signal_that_is_ignored_stays_so(number):
    """As SIGHUP after `nohup`, and SIGINT in the background of a script."""
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with signals_answered(), catch_interrupts() as arrived:
            os.kill(os.getpid(), number)
            assert not arrived() and signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


def test_the_answers_of_a_command_end_with_it():
    before = signal.getsignal(signal.SIGTERM)
    with signals_answered():
        assert signal.getsignal(signal.SIGTERM) is not before
    assert signal.getsignal(signal.SIGTERM) is before

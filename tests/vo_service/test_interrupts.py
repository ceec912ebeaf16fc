"""Signals as a request to end."""

import os
import signal

import pytest

from vo_service.interrupts import stop_on_signals


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_sets_the_stop(number: signal.Signals, code: int) -> None:
    with stop_on_signals() as stop:
        assert not stop.event.is_set()
        os.kill(os.getpid(), number)
        assert stop.event.wait(5)
    assert stop.exit_code == code


def test_a_second_ctrl_c_interrupts_at_once() -> None:
    with stop_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.event.wait(5)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_afterwards_signals_do_what_they_did() -> None:
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with stop_on_signals():
        os.kill(os.getpid(), signal.SIGINT)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_a_check_raises_once_a_stop_was_asked_for() -> None:
    with stop_on_signals() as stop:
        stop.check()
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            stop.check()


def test_work_that_shows_progress_is_interrupted_once_a_stop_was_asked_for() -> None:
    steps: list[tuple[int, int]] = []
    with stop_on_signals() as stop:
        progress = stop.interrupting(lambda done, total: steps.append((done, total)))
        progress(1, 3)
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            progress(2, 3)
    assert steps == [(1, 3)]

"""Signals as a request to end."""

import os
import signal
import subprocess
import sys
import threading
from typing import Any

import pytest

from vo_service.signals import (
    InterruptedBySignal,
    force_exit_after,
    raise_on_signals,
    stop_on_signals,
)


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_sets_the_stop_event(number: signal.Signals, code: int) -> None:
    with stop_on_signals() as stop:
        assert not stop.event.is_set()
        os.kill(os.getpid(), number)
        assert stop.event.wait(100)
    assert stop.exit_code == code


def test_a_hangup_that_nohup_ignores_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stop_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGHUP)
        assert not stop.event.wait(0.05)
    signal.signal(signal.SIGHUP, before)


def test_a_second_ctrl_c_interrupts_at_once() -> None:
    with stop_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.event.wait(100)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


INTERRUPTED_TWICE = """
import signal
from vo_service.signals import stop_on_signals
with stop_on_signals() as stop, stop.without_exceptions():
    try:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
    finally:
        print("the exception crashes a callback of LLVM", flush=True)
"""


@pytest.mark.subprocess
def test_a_second_ctrl_c_ends_a_block_whose_callbacks_must_not_raise() -> None:
    command = [sys.executable, "-c", INTERRUPTED_TWICE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (143, "", "")


def test_a_second_signal_does_not_interrupt_the_end_of_a_block() -> None:
    with raise_on_signals():
        with pytest.raises(InterruptedBySignal) as interruption:
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
    assert interruption.value.exit_code == 130


def test_afterwards_the_signal_handlers_are_restored() -> None:
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with stop_on_signals():
        os.kill(os.getpid(), signal.SIGINT)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_check_raises_after_a_stop_request(number: signal.Signals, code: int) -> None:
    with stop_on_signals() as stop:
        stop.check()
        signal.raise_signal(number)
        with pytest.raises(InterruptedBySignal) as interruption:
            stop.check()
    assert interruption.value.exit_code == code


# Not `signal.pause`: it misses a signal that comes just before it.
HANGING = """
import threading
from vo_service.signals import force_exit_after, stop_on_signals
with stop_on_signals() as stop, force_exit_after(stop, 0.2):
    print("ready", flush=True)
    while True:
        threading.Event().wait(0.1)
"""


@pytest.mark.subprocess
def test_a_block_that_does_not_end_is_force_exited() -> None:
    command = [sys.executable, "-c", HANGING]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGTERM)
        _, output = process.communicate(timeout=100)
    assert process.returncode == 1
    assert "did not end within 0.2 s after the stop request; ended by force" in output


def test_a_block_that_ends_in_time_is_not_force_exited() -> None:
    with stop_on_signals() as stop, force_exit_after(stop, 0.01):
        pass
    assert stop.exit_code == 0


def test_simultaneous_signals_do_not_block_each_other() -> None:
    with stop_on_signals() as stop:

        class Interrupted(threading.Event):
            def set(self) -> None:
                with self._cond:  # type: ignore[attr-defined]
                    signal.raise_signal(signal.SIGTERM)
                super().set()

        stop.event = Interrupted()
        signal.raise_signal(signal.SIGTERM)
        assert stop.event.is_set()

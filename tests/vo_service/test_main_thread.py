"""The loop on its own thread, and the signals on theirs."""

import os
import signal
import threading

import pytest

from drivers.core import UserFacingError
from vo_service import signals
from vo_service.signals import (
    ReloadSignal,
    StopSignal,
    reload_on_sighup,
    run_on_loop_thread,
    stop_on_signals,
)


def nothing() -> None:
    """No configuration to read."""


def test_a_signal_ends_the_loop() -> None:
    names = []

    def work(stop: threading.Event) -> None:
        names.append(threading.current_thread().name)
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.wait(100)

    with stop_on_signals() as stop:
        run_on_loop_thread(work, stop, ReloadSignal(), nothing)
    assert names == ["odometry"]
    assert stop.exit_code == 143


def test_a_loop_that_ends_by_itself_ends_the_main_thread() -> None:
    run_on_loop_thread(lambda stop: None, StopSignal(), ReloadSignal(), nothing)


def test_an_exception_of_the_loop_is_raised_in_the_main_thread() -> None:
    def work(stop: threading.Event) -> None:
        raise UserFacingError("no such camera")

    with pytest.raises(UserFacingError, match="no such camera"):
        run_on_loop_thread(work, StopSignal(), ReloadSignal(), nothing)


def test_each_sighup_reads_the_configuration_while_the_loop_continues() -> None:
    readings = threading.Semaphore(0)

    def work(stop: threading.Event) -> None:
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGHUP)
            assert readings.acquire(timeout=100)
            assert not stop.is_set()

    with reload_on_sighup() as hangup:
        run_on_loop_thread(work, StopSignal(), hangup, readings.release)


def test_a_hanging_loop_is_abandoned(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(signals, "LOOP_STOP_TIMEOUT_S", 0.05)
    release, stop = threading.Event(), StopSignal()

    def work(_: threading.Event) -> None:
        release.wait(100)

    stop.event.set()
    run_on_loop_thread(work, stop, ReloadSignal(), nothing)
    assert "the odometry did not stop within" in caplog.text
    release.set()

"""Ctrl-C and SIGTERM as a request to end, so that everything is kept; SIGHUP to read again."""

import logging
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# A shell's exit code for a program ended by Ctrl-C: 128 + SIGINT.
EXIT_CODE_SIGINT = 130

logger = logging.getLogger(__name__)


class StopSignal:
    """Set once by the first Ctrl-C or SIGTERM. A second Ctrl-C interrupts at once."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self.exit_code = 0  # the shell's for a program ended by this signal, once there is one
        self._is_requested = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if not self._is_requested:
            self.exit_code = 128 + number
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self.request()

    def request(self) -> None:
        """Ask for the end. On the main thread a signal may interrupt this very call, and ask too.

        Setting an event takes a lock: the second to ask would wait for the first, for ever.
        """
        if not self._is_requested:
            self._is_requested = True
            self.event.set()

    def check(self) -> None:
        """Raise KeyboardInterrupt once a stop was asked for."""
        if self.event.is_set():
            raise KeyboardInterrupt


@contextmanager
def stop_on_signals() -> Iterator[StopSignal]:
    """Turn SIGINT and SIGTERM into `StopSignal` while the block runs."""
    stop = StopSignal()
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class InterruptedBySignal(KeyboardInterrupt):
    """Ctrl-C or SIGTERM came; `exit_code` is the shell's for a program ended by it."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.exit_code = 128 + number


@contextmanager
def raise_on_signals() -> Iterator[None]:
    """Raise Interrupted wherever the block is, for one that can be left anywhere without harm."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise InterruptedBySignal(number)

    before = {
        number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class ReloadSignal:
    """Whether SIGHUP came. Without a lock: a handler may interrupt whoever holds one."""

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        """It has come."""
        self._is_set = True

    def clear(self) -> None:
        """It is heeded."""
        self._is_set = False

    def is_set(self) -> bool:
        """Whether it has come and is not heeded yet."""
        return self._is_set


@contextmanager
def reload_on_sighup() -> Iterator[ReloadSignal]:
    """Take note of SIGHUP while the block runs; whoever heeds it clears it."""
    hangup = ReloadSignal()
    before = signal.signal(signal.SIGHUP, lambda number, frame: hangup.set())
    try:
        yield hangup
    finally:
        signal.signal(signal.SIGHUP, before)


@contextmanager
def force_exit_after(stop: StopSignal, timeout_s: float) -> Iterator[None]:
    """End the process if the block is not over `timeout_s` after a stop was asked for."""
    is_over = threading.Event()

    def watch() -> None:
        stop.event.wait()
        if not is_over.wait(timeout_s):
            logger.error("did not end within %g s of being asked to; ended by force", timeout_s)
            os._exit(1)

    threading.Thread(target=watch, name="ending", daemon=True).start()
    try:
        yield
    finally:
        is_over.set()
        stop.request()  # so that the thread ends

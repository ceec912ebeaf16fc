"""Ctrl-C and SIGTERM as a request to end, so that everything is kept; SIGHUP to read again."""

import logging
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# A shell's exit code for a program ended by Ctrl-C: 128 + SIGINT.
INTERRUPTED = 130

logger = logging.getLogger(__name__)


class Stop:
    """Set once by the first Ctrl-C or SIGTERM. A second Ctrl-C interrupts at once."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self.exit_code = 0  # the shell's for a program ended by this signal, once there is one
        self._is_asked = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if not self._is_asked:
            self.exit_code = 128 + number
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self.request()

    def request(self) -> None:
        """Ask for the end. On the main thread a signal may interrupt this very call, and ask too.

        Setting an event takes a lock: the second to ask would wait for the first, for ever.
        """
        if not self._is_asked:
            self._is_asked = True
            self.event.set()

    def check(self) -> None:
        """Raise KeyboardInterrupt once a stop was asked for."""
        if self.event.is_set():
            raise KeyboardInterrupt


@contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """Turn SIGINT and SIGTERM into `Stop` while the block runs."""
    stop = Stop()
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM came; `exit_code` is the shell's for a program ended by it."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.exit_code = 128 + number


@contextmanager
def interrupted_at_once() -> Iterator[None]:
    """Raise Interrupted wherever the block is, for one that can be left anywhere without harm."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise Interrupted(number)

    before = {
        number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Hangup:
    """Whether SIGHUP came. Without a lock: a handler may interrupt whoever holds one."""

    def __init__(self) -> None:
        self._has_come = False

    def set(self) -> None:
        """It has come."""
        self._has_come = True

    def clear(self) -> None:
        """It is heeded."""
        self._has_come = False

    def is_set(self) -> bool:
        """Whether it has come and is not heeded yet."""
        return self._has_come


@contextmanager
def hangups() -> Iterator[Hangup]:
    """Take note of SIGHUP while the block runs; whoever heeds it clears it."""
    hangup = Hangup()
    before = signal.signal(signal.SIGHUP, lambda number, frame: hangup.set())
    try:
        yield hangup
    finally:
        signal.signal(signal.SIGHUP, before)


@contextmanager
def ended_by_force(stop: Stop, after_s: float) -> Iterator[None]:
    """End the process if the block is not over `after_s` after a stop was asked for."""
    is_over = threading.Event()

    def watch() -> None:
        stop.event.wait()
        if not is_over.wait(after_s):
            logger.error("did not end within %g s of being asked to; ended by force", after_s)
            os._exit(1)

    threading.Thread(target=watch, name="ending", daemon=True).start()
    try:
        yield
    finally:
        is_over.set()
        stop.request()  # so that the thread ends

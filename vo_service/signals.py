"""Ctrl-C and SIGTERM as a request to end, so that everything is kept; SIGHUP to read again."""

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
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


# How soon a signal is heeded.
SIGNAL_POLL_S = 0.1
# How long the loop may take for the frame at hand once it is to end.
LOOP_STOP_TIMEOUT_S = 2.5


class _LoopThread(threading.Thread):
    """Runs `work`, and keeps what it raised."""

    def __init__(self, work: Callable[[threading.Event], None], stop: threading.Event) -> None:
        # A daemon: a native call that never returns must not keep the process from ending.
        super().__init__(name="odometry", daemon=True)
        self.is_over = threading.Event()
        self.error: BaseException | None = None
        self._work, self._stop_event = work, stop

    def run(self) -> None:
        """Body of the thread."""
        try:
            self._work(self._stop_event)
        except BaseException as error:
            self.error = error
        finally:
            self.is_over.set()


def run_on_loop_thread(
    work: Callable[[threading.Event], None],
    stop: StopSignal,
    reload_signal: ReloadSignal,
    on_reload: Callable[[], None],
) -> None:
    """Run `work` on a thread of its own until it ends; call `reload` here after each hangup.

    Raises what `work` raises. Work that does not end in time once it is asked to is left behind.
    """
    loop = _LoopThread(work, stop.event)
    loop.start()
    try:
        # Not `join`: an event can be waited for again after a signal has interrupted it.
        while not loop.is_over.wait(SIGNAL_POLL_S) and not stop.event.is_set():
            if reload_signal.is_set():
                reload_signal.clear()
                on_reload()
    finally:
        stop.request()
        if not loop.is_over.wait(LOOP_STOP_TIMEOUT_S):
            logger.error("the odometry did not come to an end within %g s", LOOP_STOP_TIMEOUT_S)
    if loop.error is not None:
        raise loop.error

"""Signals: SIGINT and SIGTERM request a clean end, and so does SIGHUP if it is no reload request.

The work runs on a thread of its own; the main thread handles the signals.
"""

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from types import FrameType

# A shell's exit code for a program ended by SIGINT: 128 + SIGINT.
EXIT_CODE_SIGINT = 130
# Time between two checks for a signal.
SIGNAL_POLL_S = 0.1
# Time that the loop has to end after a stop request.
LOOP_STOP_TIMEOUT_S = 2.5

logger = logging.getLogger(__name__)


class InterruptedBySignal(KeyboardInterrupt):
    """SIGINT or SIGTERM was received.

    Attributes:
        exit_code: The shell's exit code for a program ended by this signal.
    """

    def __init__(self, exit_code: int) -> None:
        """Make the exception of a signal.

        Args:
            exit_code: The shell's exit code for a program ended by the signal.
        """
        super().__init__()
        self.exit_code = exit_code


class StopSignal:
    """A stop request, set by the first signal. A SIGINT after that interrupts at once.

    Attributes:
        event: Set once a stop is requested.
        exit_code: The shell's exit code for a program ended by the signal; 0 before a signal.
    """

    def __init__(self) -> None:
        self.event = threading.Event()
        self.exit_code = 0
        self._is_requested = False
        self._may_raise = True

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.exit_code and number == signal.SIGINT:
            if not self._may_raise:
                os._exit(self.exit_code)
            raise InterruptedBySignal(self.exit_code)
        if not self._is_requested:
            self.exit_code = 128 + number
        self.request()

    def request(self) -> None:
        """Request a stop. A signal handler may interrupt this call and call it again.

        The flag prevents a deadlock: the event's lock is not reentrant.
        """
        if not self._is_requested:
            self._is_requested = True
            self.event.set()

    @contextmanager
    def without_exceptions(self) -> Iterator[None]:
        """End the process at a second SIGINT while the block runs: native code must not raise."""
        before, self._may_raise = self._may_raise, False
        try:
            yield
        finally:
            self._may_raise = before

    def check(self) -> None:
        """Raise `InterruptedBySignal` if a stop was requested."""
        if self.event.is_set():
            raise InterruptedBySignal(self.exit_code or EXIT_CODE_SIGINT)


@contextmanager
def _handle(handler: Callable[[int, FrameType | None], None], *numbers: int) -> Iterator[None]:
    """Handle signals while the block runs."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, handler_before in before.items():
            signal.signal(number, handler_before)


@contextmanager
def stop_on_signals() -> Iterator[StopSignal]:
    """Handle SIGINT, SIGTERM and SIGHUP as a stop request while the block runs.

    SIGHUP stays ignored if it was, as by nohup.
    """
    stop = StopSignal()
    is_hangup_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    hangup = () if is_hangup_ignored else (signal.SIGHUP,)
    with _handle(stop, signal.SIGINT, signal.SIGTERM, *hangup):
        yield stop


@contextmanager
def raise_on_signals() -> Iterator[None]:
    """Raise `InterruptedBySignal` on SIGINT or SIGTERM while the block runs.

    The exception may come at any line: the block must not leave a broken state. It comes once:
    another signal would interrupt the end of the block, and Zenoh's open session the process's end.
    """
    signals = count()

    def interrupt(number: int, frame: FrameType | None) -> None:
        if next(signals) == 0:
            raise InterruptedBySignal(128 + number)

    with _handle(interrupt, signal.SIGINT, signal.SIGTERM):
        yield


class ReloadSignal:
    """A reload request, set by SIGHUP. It has no lock: a signal handler must not wait for one."""

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        """Request a reload."""
        self._is_set = True

    def clear(self) -> None:
        """Clear the request before it is handled."""
        self._is_set = False

    def is_set(self) -> bool:
        """Whether a reload is requested."""
        return self._is_set


@contextmanager
def reload_on_sighup() -> Iterator[ReloadSignal]:
    """Handle SIGHUP as a reload request while the block runs."""
    reload_signal = ReloadSignal()
    with _handle(lambda number, frame: reload_signal.set(), signal.SIGHUP):
        yield reload_signal


@contextmanager
def force_exit_after(stop: StopSignal, timeout_s: float) -> Iterator[None]:
    """End the process by force if the block does not end in time after a stop request.

    Args:
        timeout_s: Time that the block has to end, s.
    """
    is_over = threading.Event()

    def watch() -> None:
        stop.event.wait()
        if not is_over.wait(timeout_s):
            logger.error(
                "did not end within %g s after the stop request; ended by force", timeout_s
            )
            os._exit(1)

    threading.Thread(target=watch, name="force-exit", daemon=True).start()
    try:
        yield
    finally:
        is_over.set()
        stop.request()  # so that the thread ends


class _LoopThread(threading.Thread):
    """Runs `work`, and keeps the exception that it raises."""

    def __init__(self, work: Callable[[threading.Event], None], stop: threading.Event) -> None:
        # A daemon thread: a native call that never returns must not block the end of the process.
        super().__init__(name="odometry", daemon=True)
        self.is_over = threading.Event()
        self.error: BaseException | None = None
        self._work, self._stop_event = work, stop

    def run(self) -> None:
        """Run the work; the body of the thread."""
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
    """Run `work` on a thread of its own until it ends; raise what it raises.

    Work that does not end within `LOOP_STOP_TIMEOUT_S` of a stop request is abandoned.

    Args:
        work: The work; it ends soon after its event is set.
        on_reload: Called on the caller's thread for each reload request.
    """
    loop = _LoopThread(work, stop.event)
    loop.start()
    try:
        # Not `join`: a wait for an event can be repeated after a signal has interrupted it.
        while not loop.is_over.wait(SIGNAL_POLL_S) and not stop.event.is_set():
            if reload_signal.is_set():
                reload_signal.clear()
                on_reload()
    finally:
        stop.request()
        if not loop.is_over.wait(LOOP_STOP_TIMEOUT_S):
            logger.error("the odometry did not stop within %g s", LOOP_STOP_TIMEOUT_S)
    if loop.error is not None:
        raise loop.error

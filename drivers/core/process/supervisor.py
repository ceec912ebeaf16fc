"""Supervision of a background process: start, messages, restart after a crash."""

import logging
import math
import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Protocol, TypeVar

from drivers.core.process.worker_process import Heartbeat, Shutdown, start_module

logger = logging.getLogger(__name__)
_INITIAL_RETRY_S, _MAX_RETRY_S = 0.2, 30.0
# A process without a message for this long hangs, for example on a disk, or is stopped.
HEARTBEAT_TIMEOUT_S = 10.0
# How long the service waits for its end. The process then finishes its writing alone.
SHUTDOWN_TIMEOUT_S = 1.5
REAP_TIMEOUT_S = 0.5


class ExponentialBackoff:
    """Waits that double while nothing works."""

    def __init__(self, initial_s: float, max_s: float) -> None:
        self._initial_s, self._max_s = initial_s, max_s
        self._next_s = initial_s

    def next_s(self) -> float:
        """How long to wait this time."""
        wait_s = self._next_s
        self._next_s = min(2 * wait_s, self._max_s)
        return wait_s

    def reset(self) -> None:
        """Start again with the shortest wait: it worked."""
        self._next_s = self._initial_s


class FaultReporter:
    """Holds the current fault in `text` ("" for none) and logs each new fault once.

    Args:
        name: Name of the process in the log.
    """

    def __init__(self, name: str) -> None:
        self.text = ""
        self._name = name

    def set(self, text: str) -> None:
        """Set the current fault, "" for none."""
        if text and text != self.text:
            logger.error("%s: %s", self._name, text)
        self.text = text


class WorkerConfig(Protocol):
    """The first message to a background process; it can be pickled."""

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors that the process inherits, with the same numbers."""
        ...


@dataclass(frozen=True)
class BackgroundWorkerSpec:
    """The module of a background process and its name in the log.

    Its argument is the file descriptor of its `Connection`. It sends a `Heartbeat` at the start
    and every second. It ends after `Shutdown`, and when the service has ended.
    """

    module: str
    name: str


ConfigT = TypeVar("ConfigT", bound=WorkerConfig)


class WorkerSupervisor(Generic[ConfigT]):
    """Runs a background process and restarts it, on a thread of its own.

    Args:
        spec: Module and name of the process.
        config: First message to each new process.
        on_message: Called on the thread with each message of the process.
        on_exit: Called on the thread after each process that ended without `close`.
    """

    def __init__(
        self,
        spec: BackgroundWorkerSpec,
        config: ConfigT,
        on_message: Callable[[Any], None],
        on_exit: Callable[[], None],
    ) -> None:
        """Start the thread and the process."""
        self._spec = spec
        self.config = config  # of the next process
        self._on_message, self._on_exit = on_message, on_exit
        self._outgoing: deque[object] = deque()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._closing = threading.Event()
        self._last_message_s = time.monotonic()
        self._back_off = ExponentialBackoff(_INITIAL_RETRY_S, _MAX_RETRY_S)
        self.is_ready = False  # the process receives messages
        self._thread = threading.Thread(
            target=self._run, name=f"{spec.name}-supervisor", daemon=True
        )
        self._thread.start()

    @property
    def is_unresponsive(self) -> bool:
        """Whether the last message is older than `HEARTBEAT_TIMEOUT_S`."""
        return time.monotonic() - self._last_message_s > HEARTBEAT_TIMEOUT_S

    def send(self, message: object) -> None:
        """Send a message. It is lost if the process dies before handling it."""
        self._outgoing.append(message)
        os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        """End the process. One that still writes data is left running until it has finished."""
        if not self._closing.is_set():
            self.send(Shutdown())
            self._closing.set()
            self._thread.join()
            os.close(self._wake)

    def _run(self) -> None:
        while not self._closing.is_set():
            self._run_process()
            self.is_ready = False
            self._outgoing.clear()
            if not self._closing.is_set():
                self._on_exit()
                self._closing.wait(self._back_off.next_s())

    def _run_process(self) -> None:
        """Run one process until it has ended, or is left running after `close`."""
        ours, theirs = Pipe()
        with ours:
            with theirs:
                try:
                    # It shares our stderr, which then shows the output of a crash.
                    fds = (theirs.fileno(), *self.config.fds)
                    process = start_module(self._spec.module, fds, subprocess.DEVNULL, stderr=None)
                except OSError as error:
                    logger.error("%s: cannot be started: %s", self._spec.name, error.strerror)
                    return
            with suppress(OSError, EOFError):
                ours.send(self.config)
                self._serve(ours)
            with suppress(subprocess.TimeoutExpired):
                process.wait(REAP_TIMEOUT_S)

    def _serve(self, connection: "Connection[Any, Any]") -> None:
        """Send and receive messages until the end. Raises EOFError or OSError if it dies."""
        due_s = math.inf
        while (left_s := due_s - time.monotonic()) > 0.0:
            ready = wait([connection, self._wake], None if math.isinf(left_s) else left_s)
            if connection in ready:
                self._receive(connection.recv())
            if self._wake in ready:
                os.eventfd_read(self._wake)
                if self._send_pending(connection):
                    due_s = time.monotonic() + SHUTDOWN_TIMEOUT_S

    def _receive(self, message: object) -> None:
        self._last_message_s = time.monotonic()
        self._on_message(message)
        if isinstance(message, Heartbeat):
            self.is_ready = True
            self._back_off.reset()

    def _send_pending(self, connection: "Connection[Any, Any]") -> bool:
        """Send all waiting messages. Returns whether the last one was `Shutdown`."""
        is_last = False
        while self._outgoing:
            message = self._outgoing.popleft()
            connection.send(message)
            is_last = isinstance(message, Shutdown)
        return is_last

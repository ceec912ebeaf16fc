"""Keeps a process in the background running: starts it, passes on orders, starts it again."""

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

from drivers.core.process.backoff import ExponentialBackoff
from drivers.core.process.messages import Heartbeat, Shutdown
from drivers.core.process.worker_process import start_module

logger = logging.getLogger(__name__)

_INITIAL_RETRY_S, _MAX_RETRY_S = 0.2, 30.0
# Without a word for so long, it is stuck: on a disk that hangs, or stopped.
HEARTBEAT_TIMEOUT_S = 10.0
# How long the service waits for its end. What it has begun to write it then finishes by itself.
SHUTDOWN_TIMEOUT_S = 1.5
REAP_TIMEOUT_S = 0.5


class WorkerConfig(Protocol):
    """What such a process is told first, and once: it can be pickled."""

    @property
    def fds(self) -> tuple[int, ...]:
        """Files that the process shall have, each with the number that it has here."""
        ...


@dataclass(frozen=True)
class BackgroundWorkerSpec:
    """A module that is run with the number of its end of a `Connection`; its name in the log.

    Its first word and one every second is a `Heartbeat`; it ends after `Shutdown`, and without us.
    """

    module: str
    name: str


ConfigT = TypeVar("ConfigT", bound=WorkerConfig)


class WorkerSupervisor(Generic[ConfigT]):
    """A thread that owns the process. What it says goes to `hear`, on that thread."""

    def __init__(
        self,
        spec: BackgroundWorkerSpec,
        config: ConfigT,
        on_message: Callable[[Any], None],
        on_exit: Callable[[], None],
    ) -> None:
        """Start. `died` is called after each process that ended by itself."""
        self._spec = spec
        self.config = config  # of the next process
        self._on_message, self._on_exit = on_message, on_exit
        self._outgoing: deque[object] = deque()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._closing = threading.Event()
        self._last_message_s = time.monotonic()
        self._back_off = ExponentialBackoff(_INITIAL_RETRY_S, _MAX_RETRY_S)
        self.is_ready = False  # it takes orders
        self._thread = threading.Thread(target=self._run, name=f"{spec.name}-keeper", daemon=True)
        self._thread.start()

    @property
    def is_unresponsive(self) -> bool:
        """Whether it has said nothing for so long that something must be wrong."""
        return time.monotonic() - self._last_message_s > HEARTBEAT_TIMEOUT_S

    def send(self, message: object) -> None:
        """Pass an order on; a process that dies before it is carried out forgets it."""
        self._outgoing.append(message)
        os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        """Let it end. One that still has something to write is left to finish by itself."""
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
        """From the start of a process until it has ended, or is left to itself."""
        ours, theirs = Pipe()
        with ours:
            with theirs:
                try:
                    # It shares our stderr, for what it says after a crash.
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
        """Pass on orders and listen until the end. Raises EOFError or OSError if it dies."""
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
        """Send what there is to send; whether that was the last order."""
        is_last = False
        while self._outgoing:
            order = self._outgoing.popleft()
            connection.send(order)
            is_last = isinstance(order, Shutdown)
        return is_last

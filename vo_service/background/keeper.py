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

from drivers.isolation.limits import BackOff, TimeLimits
from drivers.isolation.process import start_module
from vo_service.background.messages import End, SignOfLife

logger = logging.getLogger(__name__)

_LIMITS = TimeLimits(first_retry_s=0.2, longest_retry_s=30.0)
# Without a word for so long, it is stuck: on a disk that hangs, or stopped.
SILENT_S = 10.0
# How long the service waits for its end. What it has begun to write it then finishes by itself.
ENDING_S = 1.5
REAPED_S = 0.5


class Job(Protocol):
    """What such a process is told first, and once: it can be pickled."""

    @property
    def fds(self) -> tuple[int, ...]:
        """Files that the process shall have, each with the number that it has here."""
        ...


@dataclass(frozen=True)
class Helper:
    """A module that is run with the number of its end of a `Connection`; its name in the log.

    Its first word and one every second is a `SignOfLife`; it ends after `End`, and without us.
    """

    module: str
    name: str


J = TypeVar("J", bound=Job)


class Keeper(Generic[J]):
    """A thread that owns the process. What it says goes to `hear`, on that thread."""

    def __init__(
        self, helper: Helper, job: J, hear: Callable[[Any], None], died: Callable[[], None]
    ) -> None:
        """Start. `died` is called after each process that ended by itself."""
        self._helper = helper
        self.job = job  # of the next process
        self._hear, self._died = hear, died
        self._orders: deque[object] = deque()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._closing = threading.Event()
        self._heard_s = time.monotonic()
        self._back_off = BackOff(_LIMITS)
        self.is_up = False  # it takes orders
        self._thread = threading.Thread(target=self._run, name=f"{helper.name}-keeper", daemon=True)
        self._thread.start()

    @property
    def is_silent(self) -> bool:
        """Whether it has said nothing for so long that something must be wrong."""
        return time.monotonic() - self._heard_s > SILENT_S

    def tell(self, order: object) -> None:
        """Pass an order on; a process that dies before it is carried out forgets it."""
        self._orders.append(order)
        os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        """Let it end. One that still has something to write is left to finish by itself."""
        if not self._closing.is_set():
            self.tell(End())
            self._closing.set()
            self._thread.join()
            os.close(self._wake)

    def _run(self) -> None:
        while not self._closing.is_set():
            self._run_process()
            self.is_up = False
            self._orders.clear()
            if not self._closing.is_set():
                self._died()
                self._closing.wait(self._back_off.next_s())

    def _run_process(self) -> None:
        """From the start of a process until it has ended, or is left to itself."""
        ours, theirs = Pipe()
        with ours:
            with theirs:
                try:
                    # It shares our stderr, for what it says after a crash.
                    fds = (theirs.fileno(), *self.job.fds)
                    process = start_module(
                        self._helper.module, fds, subprocess.DEVNULL, stderr=None
                    )
                except OSError as error:
                    logger.error("%s: cannot be started: %s", self._helper.name, error.strerror)
                    return
            with suppress(OSError, EOFError):
                ours.send(self.job)
                self._attend(ours)
            with suppress(subprocess.TimeoutExpired):
                process.wait(REAPED_S)

    def _attend(self, connection: "Connection[Any, Any]") -> None:
        """Pass on orders and listen until the end. Raises EOFError or OSError if it dies."""
        due_s = math.inf
        while (left_s := due_s - time.monotonic()) > 0.0:
            ready = wait([connection, self._wake], None if math.isinf(left_s) else left_s)
            if connection in ready:
                self._listen(connection.recv())
            if self._wake in ready:
                os.eventfd_read(self._wake)
                if self._pass_on(connection):
                    due_s = time.monotonic() + ENDING_S

    def _listen(self, word: object) -> None:
        self._heard_s = time.monotonic()
        self._hear(word)
        if isinstance(word, SignOfLife):
            self.is_up = True
            self._back_off.reset()

    def _pass_on(self, connection: "Connection[Any, Any]") -> bool:
        """Send what there is to send; whether that was the last order."""
        is_last = False
        while self._orders:
            order = self._orders.popleft()
            connection.send(order)
            is_last = isinstance(order, End)
        return is_last

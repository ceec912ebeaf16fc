"""The client of a worker process: it runs, watches, restarts and ends it, and passes messages."""

import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from drivers.core.process.messages import Heartbeat, Shutdown
from drivers.core.process.worker_process import WorkerProcess
from drivers.core.process.worker_spec import WorkerConfig, WorkerSpec
from drivers.core.rate_limits import ExponentialBackoff

# A process without a heartbeat for this long is reported; it may recover.
UNRESPONSIVE_S = 10.0
# After a run of this length, the delay before a restart is the shortest again.
MIN_HEALTHY_RUN_S = 30.0
# When there is nothing to start now, it is tried again after this time.
NO_CONFIG_RETRY_S = 2.0
# How long until a message is tried again that a busy process does not take.
_SEND_RETRY_S = 0.1


class WorkerClient:
    """Runs a worker process and restarts it, on a thread of its own.

    The callbacks run on that thread.

    Args:
        spec: What the process runs, and its limits.
        make_config: Called before each start. Without a result (None) no process is started now.
        on_message: Called with each message of the process.
        on_exit: Called with the reason after each process that ended without `close`. If it returns
            False, the process is not started again.
        backoff: Delays before the process is started again.
    """

    def __init__(
        self,
        spec: WorkerSpec,
        make_config: Callable[[], WorkerConfig | None],
        on_message: Callable[[Any], None],
        on_exit: Callable[[str], bool],
        backoff: ExponentialBackoff | None = None,
    ) -> None:
        """Start the thread and the process."""
        self._spec, self._make_config = spec, make_config
        self._on_message, self._on_exit = on_message, on_exit
        self.backoff = backoff or ExponentialBackoff(0.2, 30.0)
        self._outgoing: deque[object] = deque()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._wake_lock, self._send_lock = threading.Lock(), threading.Lock()
        self._process: WorkerProcess | None = None  # that receives messages
        self._closing, self._is_done = threading.Event(), threading.Event()
        self._exit_due_s = math.inf
        self._last_heartbeat_s = time.monotonic()
        self._was_killed = False
        self.ready_count = 0  # processes that have become ready
        self._thread = threading.Thread(target=self._run, name=f"{spec.name}-client", daemon=True)
        self._thread.start()

    @property
    def is_ready(self) -> bool:
        """Whether the process receives messages."""
        return self._process is not None

    @property
    def is_unresponsive(self) -> bool:
        """Whether the process is ready but its last heartbeat is older than `UNRESPONSIVE_S`."""
        return self.is_ready and time.monotonic() - self._last_heartbeat_s > UNRESPONSIVE_S

    def send(self, message: object) -> bool:
        """Send a small message without waiting. It is lost if the process dies before reading it.

        Returns:
            False if the client has ended.
        """
        with self._wake_lock:
            if self._wake < 0:
                return False
            self._outgoing.append(message)
            os.eventfd_write(self._wake, 1)
            return True

    def send_waiting(self, message: object) -> bool:
        """Send a message of any size; wait until the process has read it or is killed.

        After `Shutdown` the end of the process is expected.

        Returns:
            False if no process is ready: the message is lost.
        """
        if isinstance(message, Shutdown):
            self._closing.set()
        with self._send_lock:
            if self._process is not None:
                self._process.send(message)
            return self._process is not None

    def close(self, timeout_s: float | None = None) -> bool:
        """End the process; safe to call twice, and from several threads.

        If the call is interrupted, the thread still ends the process.

        Args:
            timeout_s: Longest time to its end; None = as its spec says.

        Returns:
            False if it was killed.
        """
        wait_s = self._spec.closing_timeout_s if timeout_s is None else timeout_s
        self._exit_due_s = min(self._exit_due_s, time.monotonic() + wait_s)
        self._closing.set()
        self.send(Shutdown())
        # Before `join`: a thread whose `join` was interrupted counts as ended in CPython 3.11.
        self._is_done.wait()
        if self._thread.is_alive():
            self._thread.join()
        return not self._was_killed

    def _run(self) -> None:
        """Body of the thread: run one process after another."""
        try:
            goes_on = True
            while goes_on and not self._closing.is_set():
                config = self._make_config()
                if config is None:
                    self._closing.wait(NO_CONFIG_RETRY_S)
                else:
                    goes_on = self._run_process(config)
        finally:
            with self._wake_lock:
                os.close(self._wake)
                self._wake = -1
            self._is_done.set()

    def _run_process(self, config: WorkerConfig) -> bool:
        """Run one process until it has ended; return whether another is to be started."""
        begin_s = time.monotonic()
        try:
            with WorkerProcess(self._spec, config) as process:
                fault = self._serve(process)
                with self._send_lock:
                    self._process = None
        except OSError as error:
            fault = f"cannot be started: {error.strerror}"
        if time.monotonic() - begin_s > MIN_HEALTHY_RUN_S:
            self.backoff.reset()
        if self._closing.is_set() or not self._on_exit(fault or process.exit_reason):
            return False
        self._closing.wait(self.backoff.next_s())
        self._outgoing.clear()
        return True

    def _serve(self, process: WorkerProcess) -> str:
        """Handle messages until the process ends or is killed; return why it was killed."""
        limit_s, activity = self._spec.start_timeout_s, "starting up"
        due_s = time.monotonic() + limit_s
        while True:
            try:
                message = self._receive(process, due_s)
            except EOFError:
                return ""
            if message is not None:
                self._on_message(message)
            if isinstance(message, Heartbeat):
                limit_s = message.timeout_s or self._spec.heartbeat_timeout_s
                activity = message.activity
                due_s = time.monotonic() + limit_s
                self._handle_heartbeat(process)
            elif time.monotonic() >= min(due_s, self._exit_due_s):
                break
        if self._closing.is_set() and self._spec.finishes_alone:
            process.leave()
        else:
            process.kill()
            self._was_killed = self._closing.is_set()
        return f"hung{activity and f' while {activity}'}: no answer for {limit_s:g} s"

    def _receive(self, process: WorkerProcess, due_s: float) -> Any:
        """Send what waits, and receive a message; None if there is none yet."""
        is_sent = self._send_pending(process)
        due_s = min(due_s, self._exit_due_s)
        if not is_sent:
            due_s = min(due_s, time.monotonic() + _SEND_RETRY_S)
        message = process.receive(max(0.0, due_s - time.monotonic()), self._wake)
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake)
        return message

    def _send_pending(self, process: WorkerProcess) -> bool:
        """Send what waits, but never wait for the process; return whether all is sent."""
        while self._outgoing:
            if not self._send_lock.acquire(blocking=False):
                return False  # another thread is sending
            try:
                if not process.can_send:
                    return False
                process.send(self._outgoing.popleft())
            finally:
                self._send_lock.release()
        return True

    def _handle_heartbeat(self, process: WorkerProcess) -> None:
        self._last_heartbeat_s = time.monotonic()
        if self._process is None:
            with self._send_lock:
                self._process = process
            self.ready_count += 1

"""A worker process as seen from the service: its start, messages, output and end."""

import logging
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import IO, Any, Protocol, Self

from drivers.core import UserFacingError

_COUNT_BYTES = 2


@dataclass(frozen=True)
class Shutdown:
    """To the worker, as the last message: finish and end."""


@dataclass(frozen=True)
class Heartbeat:
    """From the worker: it is alive and receives messages. A subclass may add its status."""

    @property
    def activity(self) -> str:
        """What the worker is doing, for the message if it hangs; "" = nothing special."""
        return ""

    @property
    def timeout_s(self) -> float | None:
        """How long until the next heartbeat at most; None = as the `WorkerSpec` says."""
        return None


@dataclass(frozen=True)
class LogMessage:
    """From the worker, for the log of the service."""

    level: int
    logger_name: str
    text: str


@dataclass(frozen=True)
class WorkerFailed:
    """From the worker, as the last message: an error that the user can understand ended it."""

    error: UserFacingError


def send_message(connection: "Connection[Any, Any]", message: object) -> None:
    """Send a message; its arrays are not copied into one buffer first.

    Raises:
        OSError: The other process has ended.
    """
    arrays: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(message, protocol=5, buffer_callback=arrays.append)
    connection.send_bytes(len(arrays).to_bytes(_COUNT_BYTES, "little") + pickled)
    for array in arrays:
        connection.send_bytes(array.raw())


def receive_message(connection: "Connection[Any, Any]") -> Any:
    """Wait for the next message.

    Raises:
        EOFError, OSError: The other process has ended.
    """
    head = connection.recv_bytes()
    count = int.from_bytes(head[:_COUNT_BYTES], "little")
    # A bytearray, so that the arrays can be written to, as after any other way to send them.
    arrays = [bytearray(connection.recv_bytes()) for _ in range(count)]
    return pickle.loads(head[_COUNT_BYTES:], buffers=arrays)


_log = logging.getLogger(__name__)
_MAX_LINE_CHARS = 200
_REAP_TIMEOUT_S = 5.0
# How long the service waits for the end of a process that finishes alone.
FINISHING_TIMEOUT_S = 1.5


@dataclass(frozen=True)
class WorkerSpec:
    """What a worker process runs, and its limits.

    Attributes:
        function: "MODULE:FUNCTION". The process calls it with its `ServiceConnection`.
        name: Name in the log.
        start_timeout_s: Longest time to the first heartbeat.
        heartbeat_timeout_s: Longest time between two heartbeats. After it the process is killed.
        exit_timeout_s: Longest time to end, when asked to or when the service has ended. After it
            the process is killed.
        finishes_alone: The service does not wait for the end of the process, which may still write
            data. It also prints to the service's stderr, since nobody may be left to log that.
        orphan_timeout_s: Longest time until a process whose native code holds the GIL is killed
            when the service has ended.
        nice: Added to its niceness: poses have priority if CPUs are scarce.
        oom_score_adj: How readily the kernel kills it when memory runs out: at most 1000.
        memory_mb: Its memory limit; 0 = none.
        memory_key: The configuration key of the memory limit, for the message.
    """

    function: str
    name: str
    start_timeout_s: float = 60.0
    heartbeat_timeout_s: float = 120.0
    exit_timeout_s: float = 1.5
    finishes_alone: bool = False
    orphan_timeout_s: float = 20.0
    nice: int = 0
    oom_score_adj: int | None = None
    memory_mb: int = 0
    memory_key: str = ""

    @property
    def closing_timeout_s(self) -> float:
        """How long the service waits for the end of the process."""
        return FINISHING_TIMEOUT_S if self.finishes_alone else self.exit_timeout_s


class WorkerConfig(Protocol):
    """What a worker is to do. It is sent to the process as a part of the first message."""

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors that the process inherits, with the same numbers."""
        ...


@dataclass(frozen=True)
class StartWorker:
    """The first message to a worker process; see `WorkerSpec`."""

    spec: WorkerSpec
    config: WorkerConfig
    log_level: int


class WorkerProcess:
    """A running worker process. Leaving the context ends it.

    The output of native libraries is logged at level debug; the last line may explain a crash.

    Args:
        spec: What it runs, and its limits.
        config: What it is to do.

    Raises:
        OSError: The process cannot be started.
    """

    def __init__(self, spec: WorkerSpec, config: WorkerConfig) -> None:
        self._spec = spec
        self._error: Exception | None = None
        self._connection, theirs = Pipe()
        with theirs:
            try:
                self._process = start_worker(
                    spec.function,
                    (theirs.fileno(), *config.fds),
                    stdout=subprocess.DEVNULL if spec.finishes_alone else subprocess.PIPE,
                    stderr=None if spec.finishes_alone else subprocess.STDOUT,
                )
            except OSError:
                self._connection.close()
                raise
        self._output = _OutputLogger(spec.name, self._process.stdout)
        self._is_left = False
        self.send(StartWorker(spec, config, logging.getLogger().getEffectiveLevel()))

    def send(self, message: object) -> None:
        """Send a message; it is lost if the process has died. Blocks while nobody reads."""
        with suppress(OSError):
            send_message(self._connection, message)

    @property
    def can_send(self) -> bool:
        """Whether a small message can be sent without waiting."""
        poll = select.poll()
        poll.register(self._connection.fileno(), select.POLLOUT)
        return bool(poll.poll(0))

    def receive(self, timeout_s: float, *wake_fds: int) -> Any:
        """Wait for the next message; a `LogMessage` is logged.

        Returns:
            The message; None after `timeout_s`, after a `LogMessage`, or if one of `wake_fds` can
            be read.

        Raises:
            EOFError: The process has ended.
        """
        sources: list[Any] = [self._connection, *wake_fds, *self._output.sources]
        ready = wait(sources, timeout_s)
        self._output.log_available()
        if self._connection not in ready:
            return None
        try:
            message = receive_message(self._connection)
        except OSError as error:
            raise EOFError from error
        if isinstance(message, LogMessage):
            logger = logging.getLogger(message.logger_name)
            logger.log(message.level, "%s", message.text)
            return None
        if isinstance(message, WorkerFailed):
            self._error = message.error
        return message

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()

    def leave(self) -> None:
        """Leave the process running when the context is left; it ends on its own."""
        self._is_left = True

    @property
    def exit_reason(self) -> str:
        """How the process ended, in words; valid after leaving the context."""
        if self._error is not None:
            return str(self._error)
        code = self._process.poll() or 0
        how = f"ended (exit code {code})"
        if code < 0:
            how = f"crashed (signal {-code}, {signal.strsignal(-code)})"
        return f"{how}; last line: {self._output.last_line}" if self._output.last_line else how

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        try:
            self._reap()
        finally:
            self._output.log_available()
            self._output.close()
            self._connection.close()

    def _reap(self) -> None:
        """Wait for the end, then kill the process.

        Its messages are read meanwhile: a process that blocks on sending cannot end.
        """
        if self._is_left:
            threading.Thread(target=self._process.wait, name="reaper", daemon=True).start()
            return
        due_s = time.monotonic() + self._spec.closing_timeout_s
        try:
            with suppress(EOFError):
                while (left_s := due_s - time.monotonic()) > 0.0:
                    self.receive(left_s)
            self._process.wait(max(0.0, due_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._process.kill()
            with suppress(subprocess.TimeoutExpired):  # the process hangs in the kernel
                self._process.wait(_REAP_TIMEOUT_S)


class _OutputLogger:
    """Logs the lines that the process prints."""

    def __init__(self, name: str, pipe: IO[bytes] | None) -> None:
        self._name = name
        self._partial_line = b""
        self.sources = [] if pipe is None else [pipe]  # to wait for; empty after the end
        self._pipes = list(self.sources)
        self.last_line = ""
        for each in self._pipes:
            os.set_blocking(each.fileno(), False)

    def log_available(self) -> None:
        """Log the lines that have arrived."""
        with suppress(BlockingIOError):
            while self.sources:
                data = os.read(self.sources[0].fileno(), 65536)
                if not data:
                    self.sources.clear()
                *lines, self._partial_line = (self._partial_line + data).split(b"\n")
                for line in lines:
                    self._log_line(line)

    def close(self) -> None:
        """Log the incomplete last line and close the pipe."""
        self._log_line(self._partial_line)
        for pipe in self._pipes:
            pipe.close()

    def _log_line(self, line: bytes) -> None:
        text = "".join(c for c in line.decode(errors="replace").strip() if c.isprintable())
        if text:
            self.last_line = text[:_MAX_LINE_CHARS]
            _log.debug("%s: %s", self._name, text)


def start_worker(
    function: str, fds: Sequence[int], stdout: int, stderr: int | None
) -> "subprocess.Popen[bytes]":
    """Start the process of a worker.

    Args:
        function: "MODULE:FUNCTION" of the worker.
        fds: File descriptors that the process inherits. The first is that of its connection.
        stdout: As for `subprocess.Popen`.
        stderr: As for `subprocess.Popen`.

    Raises:
        OSError: The process cannot be started.
    """
    # The process imports the same modules as this one, and none from the working folder. It has a
    # session of its own, so that Ctrl-C in the terminal reaches only the service.
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "drivers.core.process.worker_main", function, str(fds[0])],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        bufsize=0,
        pass_fds=fds,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
    )

"""A worker process as seen from the service: its start, output and end."""

import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import wait
from typing import IO, Any, Self

from drivers.core.process.messages import (
    LogMessage,
    StartWorker,
    WorkerFailed,
    receive_message,
    send_message,
)
from drivers.core.process.worker_spec import WorkerConfig, WorkerSpec

logger = logging.getLogger(__name__)
_MAX_LINE_CHARS = 200
_REAP_TIMEOUT_S = 5.0
# A worker has one thread of OpenCV, which it imports when it needs it.
_WORKER_ENVIRONMENT = {"OPENCV_FOR_THREADS_NUM": "1"}


class WorkerProcess:
    """A running worker process. Leaving the context ends it.

    The output of native libraries is logged at level debug; the last line may explain a crash.

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

    def fileno(self) -> int:
        """Return what is readable when a message has come (`multiprocessing.connection.wait`)."""
        return self._connection.fileno()

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
            logger.debug("%s: %s", self._name, text)


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
        env={
            **os.environ,
            **_WORKER_ENVIRONMENT,
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        },
        start_new_session=True,
    )

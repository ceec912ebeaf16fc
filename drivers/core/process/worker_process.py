"""A worker process as seen from the service: its start, messages, output and end."""

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import wait
from types import TracebackType
from typing import IO, Any, Self

_log = logging.getLogger(__name__)
_MAX_LINE_CHARS = 200
_REAP_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class Shutdown:
    """To the process, as the last message: the service ends in order."""


@dataclass(frozen=True)
class Heartbeat:
    """From the process, every second: it is alive and receives messages."""


@dataclass(frozen=True)
class LogMessage:
    """From the worker, for the log of the service."""

    level: int
    logger_name: str
    text: str


@dataclass(frozen=True)
class WorkerSpec:
    """The module of a worker process and its name in the log.

    Its argument is the file descriptor of its `Connection`. It must ignore SIGTERM and end when
    the other end of the connection is closed.
    """

    module: str
    name: str


class WorkerProcess:
    """A running worker process. Leaving the context ends it.

    The output of native libraries is logged at level debug; the last line may explain a crash.

    Args:
        spec: Module and name of the process.
        fds: File descriptors that the process inherits.
        exit_timeout_s: How long the process may take to end before it is killed.

    Raises:
        OSError: The process cannot be started.
    """

    def __init__(self, spec: WorkerSpec, fds: Sequence[int], exit_timeout_s: float) -> None:
        self._exit_timeout_s = exit_timeout_s
        self._connection, theirs = Pipe()
        with theirs:
            try:
                self._process = start_module(
                    spec.module,
                    (theirs.fileno(), *fds),
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                )
            except OSError:
                self._connection.close()
                raise
        assert self._process.stdout is not None
        self._output = _OutputLogger(spec.name, self._process.stdout)

    def send(self, message: object) -> None:
        """Send a message; it is lost if the process has died."""
        with suppress(OSError):
            self._connection.send(message)

    def send_parts(self, parts: Iterable[bytes | memoryview]) -> None:
        """Send the parts of one message; they are lost if the process has died."""
        with suppress(OSError):
            for part in parts:
                self._connection.send_bytes(part)

    def receive(self, timeout_s: float, *wake_fds: int) -> Any:
        """Wait for the next message.

        Returns:
            The message; None after `timeout_s`, or if one of `wake_fds` can be read.

        Raises:
            EOFError: The process has ended.
        """
        sources: list[Any] = [self._connection, *wake_fds, *self._output.sources]
        ready = wait(sources, timeout_s)
        self._output.log_available()
        if self._connection not in ready:
            return None
        try:
            return self._connection.recv()
        except OSError as error:
            raise EOFError from error

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()

    @property
    def exit_reason(self) -> str:
        """How the process ended, in words; valid after leaving the context."""
        code = self._process.poll() or 0
        how = f"ended (exit code {code})"
        if code < 0:
            how = f"crashed (signal {-code}, {signal.strsignal(-code)})"
        return f"{how}; last line: {self._output.last_line}" if self._output.last_line else how

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
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
        due_s = time.monotonic() + self._exit_timeout_s
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

    def __init__(self, name: str, pipe: IO[bytes]) -> None:
        self._name = name
        self._pipe = pipe
        self._partial_line = b""
        self.sources = [pipe]  # to wait for; empty after the end of the output
        self.last_line = ""
        os.set_blocking(pipe.fileno(), False)

    def log_available(self) -> None:
        """Log the lines that have arrived."""
        with suppress(BlockingIOError):
            while self.sources:
                data = os.read(self._pipe.fileno(), 65536)
                if not data:
                    self.sources.clear()
                *lines, self._partial_line = (self._partial_line + data).split(b"\n")
                for line in lines:
                    self._log_line(line)

    def close(self) -> None:
        """Log the incomplete last line and close the pipe."""
        self._log_line(self._partial_line)
        self._pipe.close()

    def _log_line(self, line: bytes) -> None:
        text = "".join(c for c in line.decode(errors="replace").strip() if c.isprintable())
        if text:
            self.last_line = text[:_MAX_LINE_CHARS]
            _log.debug("%s: %s", self._name, text)


def start_module(
    module: str, fds: Sequence[int], stdout: int, stderr: int | None
) -> "subprocess.Popen[bytes]":
    """Run a module as a process.

    Args:
        module: Name of the module.
        fds: File descriptors that the process inherits. The first is the module's connection; its
            number is the only argument.
        stdout: As for `subprocess.Popen`.
        stderr: As for `subprocess.Popen`.

    Raises:
        OSError: The process cannot be started.
    """
    # The process imports the same modules as this one, and none from the working folder. It has a
    # session of its own, so that Ctrl-C in the terminal reaches only the service.
    return subprocess.Popen(
        [sys.executable, "-P", "-m", module, str(fds[0])],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        bufsize=0,
        pass_fds=fds,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
    )

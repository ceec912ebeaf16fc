"""A process of our own, such as a driver's, as seen from the service."""

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

_MAX_LINE_CHARS = 200
_REAP_TIMEOUT_S = 5.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WorkerSpec:
    """A module that is run with the number of its end of a `Connection`, and its name in the log.

    It must ignore SIGTERM and end when the other end of the connection is gone.
    """

    module: str
    name: str


class WorkerProcess:
    """Starts the process; leaving the context ends it and leaves nothing of it.

    What native libraries print goes to the log at level debug; the last line may explain a crash.
    """

    def __init__(self, spec: WorkerSpec, fds: Sequence[int], exit_timeout_s: float) -> None:
        """`fds` go to the process; it may take `patience_s` to end by itself. Raises OSError."""
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
        """Send a message; a process that has died hears nothing."""
        with suppress(OSError):
            self._connection.send(message)

    def send_parts(self, parts: Iterable[bytes | memoryview]) -> None:
        """Send what the process puts together again; one that has died hears nothing."""
        with suppress(OSError):
            for part in parts:
                self._connection.send_bytes(part)

    def receive(self, timeout_s: float, *wake_fds: int) -> Any:
        """Wait for the next word. None: none yet, after `timeout_s` or as a wake can be read.

        Raises EOFError if the process has ended.
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
        """End it now."""
        self._process.kill()

    @property
    def exit_reason(self) -> str:
        """How it ended, in words, once the context has been left."""
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
        """Hear it out, as a process that cannot speak cannot end; then kill it if it must be."""
        due_s = time.monotonic() + self._exit_timeout_s
        try:
            with suppress(EOFError):
                while (left_s := due_s - time.monotonic()) > 0.0:
                    self.receive(left_s)
            self._process.wait(max(0.0, due_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._process.kill()
            with suppress(subprocess.TimeoutExpired):  # it is stuck in the kernel
                self._process.wait(_REAP_TIMEOUT_S)


class _OutputLogger:
    """Lines that the process prints."""

    def __init__(self, name: str, pipe: IO[bytes]) -> None:
        self._name = name
        self._pipe = pipe
        self._partial_line = b""
        self.sources = [pipe]  # to wait for, while something may come
        self.last_line = ""
        os.set_blocking(pipe.fileno(), False)

    def log_available(self) -> None:
        """Log the lines that are there."""
        with suppress(BlockingIOError):
            while self.sources:
                data = os.read(self._pipe.fileno(), 65536)
                if not data:
                    self.sources.clear()
                *lines, self._partial_line = (self._partial_line + data).split(b"\n")
                for line in lines:
                    self._log_line(line)

    def close(self) -> None:
        """Log what has no end of line, and release the pipe."""
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
    """Run a module of ours as a process that gets `fds`; the first, a connection, by its number.

    `stdout` and `stderr` are as for `subprocess`. Raises OSError.
    """
    # The same modules as here, and none from the working folder. A session of its own: Ctrl-C in
    # the terminal is for the service alone.
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

"""Capture of Zenoh's own log, which Zenoh always writes to file descriptor 1."""

import fcntl
import logging
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress

import zenoh

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.access_denied_log import LOG_FILTER, AccessDeniedParser, parse_line

logger = logging.getLogger(__name__)

# Largest pipe without root: half a second of the worst flood.
_PIPE_BYTES = 1 << 20
_CHUNK_BYTES = 1 << 16
_PERIOD_S = 10.0
_MAX_LINES_IN_PERIOD = 5


class LogRateLimit:
    """Logs the first few clauses at once and a count of the rest every ten seconds."""

    def __init__(
        self, log_line: Callable[[str], None], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._log_line = log_line
        self._now_s = now_s
        self._since_s = -_PERIOD_S
        self._logged: list[str] = []
        self._suppressed = 0

    def add(self, clause: str) -> None:
        """Log a clause, or count it."""
        self.poll()
        if clause in self._logged or len(self._logged) >= _MAX_LINES_IN_PERIOD:
            self._suppressed += 1
            return
        if not self._logged:
            self._since_s = self._now_s()
        self._logged.append(clause)
        self._log_line(clause)

    def poll(self) -> None:
        """Log the summary if it is due. Call this now and then."""
        if self._now_s() - self._since_s >= _PERIOD_S and not self.log_summary():
            self._logged = []

    def log_summary(self) -> bool:
        """Log how many clauses were suppressed; return False if none were."""
        if not self._suppressed:
            return False
        self._log_line(f"and {self._suppressed} more such refusals")
        self._since_s, self._suppressed = self._now_s(), 0
        return True


def log_access_denied(config: ZenohConfig) -> AbstractContextManager[None]:
    """Capture Zenoh's log if access control is possible: only a file can set TLS or rules."""
    return nullcontext() if config.config_file is None else capture_zenoh_log()


@contextmanager
def capture_zenoh_log() -> Iterator[None]:
    """Log Zenoh's refusals while the block runs, with a rate limit.

    Output of child processes still goes to standard output. So does Zenoh's log if ``RUST_LOG``
    names it, such as ``RUST_LOG=zenoh=debug``. Zenoh never waits: lines that do not fit into the
    pipe are lost. Only one block may run at a time, as it replaces file descriptor 1.
    """
    sys.stdout.flush()
    readable, writable = os.pipe()
    with suppress(OSError):  # a smaller pipe is enough
        fcntl.fcntl(writable, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    os.set_blocking(writable, False)
    own = os.dup(1)
    python_stdout, sys.stdout = sys.stdout, os.fdopen(own, "w", buffering=1, closefd=False)
    os.dup2(writable, 1)
    os.close(writable)
    reader = threading.Thread(target=_read_log, args=(readable, own), name="zenoh-log", daemon=True)
    reader.start()
    with _hide_variable("RUST_LOG"):
        zenoh.init_log_from_env_or(LOG_FILTER)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stdout = python_stdout
        os.dup2(own, 1)
        reader.join(1.0)  # times out if a child process still holds the pipe


@contextmanager
def _hide_variable(name: str) -> Iterator[None]:
    """Hide an environment variable unless it is meant for Zenoh."""
    value = os.environ.get(name, "")
    if "zenoh" in value or not value:
        yield
        return
    del os.environ[name]
    try:
        yield
    finally:
        os.environ[name] = value


def _read_log(readable: int, own: int) -> None:
    """Handle lines until the pipe has no writer."""
    parser = AccessDeniedParser()
    rate_limit = LogRateLimit(lambda clause: logger.warning("zenoh: %s", clause))
    rest = b""
    while True:
        ready, _, _ = select.select([readable], [], [], 1.0)
        rate_limit.poll()
        if not ready:
            continue
        chunk = os.read(readable, _CHUNK_BYTES)
        if not chunk:
            break
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            _handle_line(line, parser, rate_limit, own)
        rest = rest[:_CHUNK_BYTES]
    rate_limit.log_summary()
    os.close(readable)
    os.close(own)


def _handle_line(
    line: bytes, parser: AccessDeniedParser, rate_limit: LogRateLimit, own: int
) -> None:
    parsed = parse_line(line.decode(errors="replace"))
    if parsed is None or "zenoh" in os.environ.get("RUST_LOG", ""):
        with suppress(OSError):  # standard output is closed
            os.write(own, line + b"\n")
    if parsed is not None and (clause := parser.describe(parsed)):
        rate_limit.add(clause)

"""Parser of the lines in Zenoh's log that report denied access.

Zenoh logs a failed TLS handshake at level WARN, without the address. It logs a message that access
control blocks at level TRACE: with the common name at a new decision, with only the session's
number at a cached one. The line formats are those of Zenoh 1.10.
"""

import fcntl
import logging
import os
import re
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass

import zenoh

from vo_service.config_tables import ZenohConfig

logger = logging.getLogger(__name__)

# Zenoh's log filter: only these modules. They log at most one line per pose.
LOG_FILTER = (
    "off,zenoh_link_tls=warn,zenoh_link_quic=warn,"
    "zenoh::net::routing::interceptor::access_control=trace"
)
_ANSI_COLORS = re.compile(r"\x1b\[[0-9;]*m")
_LINE = re.compile(
    r"\d{4}-\d\d-\d\dT\S+Z +(?P<level>[A-Z]+) (?P<thread>.*?ThreadId\(\d+\)) "
    r"(?P<target>zenoh[\w:]*): (?P<text>.*)"
)
_SUBJECT = re.compile(r"(?P<session>[0-9a-f]+) on (?P<subject>\S.*?) is (?:un)?authorized to ")
_DENIED = re.compile(
    r"(?:Using cached result: )?(?P<session>[0-9a-f]+)(?: on .*?)? is unauthorized to "
    r"(?P<action>[A-Z][\w/ ]*) \(ingress\) on (?P<key>.*)"
)
# Before the first decision on a key, Zenoh logs a dry run of all its actions.
_DRY_RUN_MARKER = "caching permissions for"
_DRY_RUN_LINES = 9
_MAX_CLAUSE_CHARS = 120
_MAX_SESSIONS = 1000
_HANDSHAKE_REASONS = (
    ("peer sent no certificates", "it sends no certificate"),
    ("UnknownIssuer", "its certificate is from an unknown authority"),
    ("BadSignature", "its certificate is from an unknown authority"),  # with the name of ours
    ("certificate expired", "its certificate has expired"),
    ("not valid yet", "its certificate is not valid yet; are both clocks right?"),
    ("InvalidPurpose", "its certificate is not for clients"),
    ("extended key usage", "its certificate is not for clients"),
    ("UnknownCA", "it does not trust our certificate"),
    ("BadCertificate", "it does not accept our certificate"),
    ("CertificateUnknown", "it does not accept our certificate"),
    ("InvalidContentType", "it does not speak TLS"),
    ("handshake eof", "it disconnected during the handshake"),
    ("timed out", "the handshake timed out"),
    ("elapsed", "the handshake timed out"),
)
# Largest pipe without root: half a second of the worst flood.
_PIPE_BYTES = 1 << 20
_CHUNK_BYTES = 1 << 16
_PERIOD_S = 10.0
_MAX_LINES_IN_PERIOD = 5


@dataclass(frozen=True)
class ZenohLogLine:
    """A parsed line of Zenoh's log."""

    level: str
    thread: str
    target: str
    text: str


def parse_line(line: str) -> ZenohLogLine | None:
    """Parse a line; None if it is not from Zenoh."""
    match = _LINE.fullmatch(_ANSI_COLORS.sub("", line))
    return ZenohLogLine(**match.groupdict()) if match else None


class AccessDeniedParser:
    """Parser of the log line by line, which remembers the sessions' names."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}  # by session
        self._dry_run_lines_left: dict[str, int] = {}  # lines to come, by thread

    def describe(self, line: ZenohLogLine) -> str:
        """Describe a refusal, such as "refused a connection: ..."; "" if the line is none."""
        if line.target.startswith("zenoh_link_"):
            return f"refused a connection: {_handshake_reason(line.text)}"
        if not line.target.endswith("::access_control"):
            return ""
        self._remember_session_name(line.text)
        if self._is_dry_run(line):
            return ""
        denied = _DENIED.fullmatch(line.text)
        if denied is None:
            return ""
        name = self._names.get(denied["session"], f"session {denied['session']}")
        return sanitize(f"denied {name}: {denied['action'].lower()} on {denied['key']}")

    def _is_dry_run(self, line: ZenohLogLine) -> bool:
        if _DRY_RUN_MARKER in line.text:
            self._dry_run_lines_left[line.thread] = _DRY_RUN_LINES
            return True
        remaining = self._dry_run_lines_left.pop(line.thread, 0)
        if remaining > 1:
            self._dry_run_lines_left[line.thread] = remaining - 1
        return remaining > 0

    def _remember_session_name(self, text: str) -> None:
        match = _SUBJECT.match(text)
        if match is None or match["session"] in self._names:
            return
        if len(self._names) >= _MAX_SESSIONS:
            self._names.clear()
        self._names[match["session"]] = _session_name(match["subject"])


def sanitize(text: str) -> str:
    """Make untrusted text safe for a log: printable and of bounded length."""
    printable = "".join(char if char.isprintable() else "?" for char in text)
    if len(printable) <= _MAX_CLAUSE_CHARS:
        return printable
    return f"{printable[: _MAX_CLAUSE_CHARS - 3]}..."


def _session_name(subject: str) -> str:
    """Shorten ``Interface(lo)+CertCommonName(reader)+Transport(Tls)+...``."""
    for pattern, name in ((r"CertCommonName\((.*?)\)", '"{}"'), (r"Username\((.*?)\)", "user {}")):
        match = re.search(pattern, subject)
        if match:
            return name.format(match[1])
    protocol = re.search(r"Transport\((.*?)\)", subject)
    return f"a session over {protocol[1].lower() if protocol else 'an unknown link'}"


def _handshake_reason(text: str) -> str:
    for marker, reason in _HANDSHAKE_REASONS:
        if marker in text:
            return reason
    return sanitize(text.partition(". Hint:")[0])


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

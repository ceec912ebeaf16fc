"""Parser of the lines in Zenoh's log that report denied access.

Zenoh logs a failed TLS handshake at level WARN, without the address. It logs a message that access
control blocks at level TRACE: with the common name at a new decision, with only the session's
number at a cached one. The line formats are those of Zenoh 1.10.
"""

import re
from dataclasses import dataclass

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

"""What Zenoh's own log says of those whom it turns away, in words for a person.

Zenoh tells of a failed TLS handshake at level WARN, without the address, and of a message that
access control holds back at level TRACE: in one line each, with the common name where it decides
anew and with the session's number alone where it remembers. The forms are those of Zenoh 1.10.
"""

import re
from dataclasses import dataclass

# What Zenoh is asked to log: nothing else, and nothing that comes with every pose but one line.
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
# Before it decides on a key for the first time, Zenoh logs what all its actions would meet with.
_DRY_RUN_MARKER = "caching permissions for"
_DRY_RUN_LINES = 9
_MAX_CLAUSE_CHARS = 120
_MAX_SESSIONS = 1000
_HANDSHAKE_REASONS = (
    ("peer sent no certificates", "it shows no certificate"),
    ("UnknownIssuer", "its certificate is from an unknown authority"),
    ("BadSignature", "its certificate is from an unknown authority"),  # of the same name as ours
    ("certificate expired", "its certificate has expired"),
    ("not valid yet", "its certificate is not valid yet; are both clocks right?"),
    ("InvalidPurpose", "its certificate is not one for clients"),
    ("extended key usage", "its certificate is not one for clients"),
    ("UnknownCA", "it does not trust our certificate"),
    ("BadCertificate", "it does not accept our certificate"),
    ("CertificateUnknown", "it does not accept our certificate"),
    ("InvalidContentType", "it does not speak TLS"),
    ("handshake eof", "it left before it had said who it is"),
    ("timed out", "it did not say in time who it is"),
    ("elapsed", "it did not say in time who it is"),
)


@dataclass(frozen=True)
class ZenohLogLine:
    """A line of Zenoh's log, taken apart."""

    level: str
    thread: str
    target: str
    text: str


def parse_line(line: str) -> ZenohLogLine | None:
    """Take a line apart; None if it is not from Zenoh."""
    found = _LINE.fullmatch(_ANSI_COLORS.sub("", line))
    return ZenohLogLine(**found.groupdict()) if found else None


class AccessDeniedParser:
    """Reads the log line by line, and remembers who the sessions are."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}  # by session
        self._dry_run_lines_left: dict[str, int] = {}  # lines to come, by thread

    def describe(self, line: ZenohLogLine) -> str:
        """Who was refused what, such as "refused a connection: ..."; "" if nobody was."""
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
        found = _SUBJECT.match(text)
        if found is None or found["session"] in self._names:
            return
        if len(self._names) >= _MAX_SESSIONS:
            self._names.clear()
        self._names[found["session"]] = _session_name(found["subject"])


def sanitize(text: str) -> str:
    """A text that a stranger may have had a hand in, fit for a log."""
    shown = "".join(sign if sign.isprintable() else "?" for sign in text)
    return shown if len(shown) <= _MAX_CLAUSE_CHARS else f"{shown[: _MAX_CLAUSE_CHARS - 3]}..."


def _session_name(subject: str) -> str:
    """``Interface(lo)+CertCommonName(reader)+Transport(Tls)+...``, shortened."""
    for form, shown in ((r"CertCommonName\((.*?)\)", '"{}"'), (r"Username\((.*?)\)", "user {}")):
        found = re.search(form, subject)
        if found:
            return shown.format(found[1])
    protocol = re.search(r"Transport\((.*?)\)", subject)
    return f"a session over {protocol[1].lower() if protocol else 'an unknown link'}"


def _handshake_reason(text: str) -> str:
    for sign, reason in _HANDSHAKE_REASONS:
        if sign in text:
            return reason
    return sanitize(text.partition(". Hint:")[0])

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
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
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
_REHEARSAL = "caching permissions for"
_REHEARSED = 9
_LONGEST = 120
_MOST_SESSIONS = 1000
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
class LogLine:
    """A line of Zenoh's log, taken apart."""

    level: str
    thread: str
    target: str
    text: str


def parse_line(line: str) -> LogLine | None:
    """Take a line apart; None if it is not from Zenoh."""
    found = _LINE.fullmatch(_COLOURS.sub("", line))
    return LogLine(**found.groupdict()) if found else None


class Refusals:
    """Reads the log line by line, and remembers who the sessions are."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}  # by session
        self._rehearsing: dict[str, int] = {}  # lines to come, by thread

    def clause(self, line: LogLine) -> str:
        """Who was refused what, such as "refused a connection: ..."; "" if nobody was."""
        if line.target.startswith("zenoh_link_"):
            return f"refused a connection: {_handshake_reason(line.text)}"
        if not line.target.endswith("::access_control"):
            return ""
        self._learn(line.text)
        if self._is_rehearsal(line):
            return ""
        denied = _DENIED.fullmatch(line.text)
        if denied is None:
            return ""
        name = self._names.get(denied["session"], f"session {denied['session']}")
        return printable(f"denied {name}: {denied['action'].lower()} on {denied['key']}")

    def _is_rehearsal(self, line: LogLine) -> bool:
        if _REHEARSAL in line.text:
            self._rehearsing[line.thread] = _REHEARSED
            return True
        remaining = self._rehearsing.pop(line.thread, 0)
        if remaining > 1:
            self._rehearsing[line.thread] = remaining - 1
        return remaining > 0

    def _learn(self, text: str) -> None:
        found = _SUBJECT.match(text)
        if found is None or found["session"] in self._names:
            return
        if len(self._names) >= _MOST_SESSIONS:
            self._names.clear()
        self._names[found["session"]] = _name(found["subject"])


def printable(text: str) -> str:
    """A text that a stranger may have had a hand in, fit for a log."""
    shown = "".join(sign if sign.isprintable() else "?" for sign in text)
    return shown if len(shown) <= _LONGEST else f"{shown[: _LONGEST - 3]}..."


def _name(subject: str) -> str:
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
    return printable(text.partition(". Hint:")[0])

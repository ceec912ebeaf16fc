"""Parsing of Zenoh's log, and its rate limit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vo_service.fakes import FakeClock
from vo_service.outputs.zenoh.access_denied_log import (
    AccessDeniedParser,
    LogRateLimit,
    parse_line,
    sanitize,
)

SESSION = "3b57c0fb217d7c04ac2566e74850a739"


def line(text: str, target: str = "zenoh_link_tls::unicast", level: str = "WARN") -> str:
    """Format a line as Zenoh writes it, with colors."""
    return (
        f"\x1b[2m2026-11-21T16:35:58.828375Z\x1b[0m \x1b[33m {level}\x1b[0m acc-0 ThreadId(05) "
        f"\x1b[2m{target}\x1b[0m\x1b[2m:\x1b[0m {text}"
    )


def clause(parser: AccessDeniedParser, text: str, **where: str) -> str:
    parsed = parse_line(line(text, **where))
    assert parsed is not None
    return parser.describe(parsed)


@pytest.mark.parametrize(
    ("zenoh_text", "reason"),
    [
        ("peer sent no certificates", "it sends no certificate"),
        ("invalid peer certificate: UnknownIssuer", "its certificate is from an unknown authority"),
        ("invalid peer certificate: certificate expired: verification", "has expired"),
        ("received corrupt message of type InvalidContentType", "it does not speak TLS"),
        ("something quite new", "something quite new"),
    ],
)
def test_a_failed_handshake_has_a_plain_reason(zenoh_text: str, reason: str) -> None:
    lines = clause(
        AccessDeniedParser(), f"{zenoh_text}. Hint: increase the system open file limit."
    )
    assert lines.startswith("refused a connection: ")
    assert lines.endswith(reason)


def test_a_denied_message_has_its_sender() -> None:
    where = {"target": "zenoh::net::routing::interceptor::access_control", "level": "TRACE"}
    subject = f"{SESSION} on Interface(lo)+CertCommonName(reader)+Transport(Tls)+{SESSION}"
    parser, action = AccessDeniedParser(), "Query (ingress) on kinect/command/reset"
    first = clause(parser, f"{subject} is unauthorized to {action}", **where)
    again = clause(parser, f"Using cached result: {SESSION} is unauthorized to {action}", **where)
    assert first == again == 'denied "reader": query on kinect/command/reset'


def test_allowed_messages_are_no_refusal() -> None:
    where = {"target": "zenoh::net::routing::interceptor::access_control", "level": "TRACE"}
    parser, subject_is = (
        AccessDeniedParser(),
        f"{SESSION} on Interface(lo)+Transport(Tls)+{SESSION} is",
    )
    assert clause(parser, f"{subject_is} authorized to Put (ingress) on a", **where) == ""
    assert (
        clause(parser, f"{subject_is} unauthorized to Declare Queryable (egress) on a", **where)
        == ""
    )


@pytest.mark.slow
@given(st.text())
def test_any_log_line_is_parsed(text: str) -> None:
    parsed = parse_line(text)
    assert parsed is None or isinstance(AccessDeniedParser().describe(parsed), str)


@given(st.text())
def test_text_of_an_outsider_stays_on_one_line(text: str) -> None:
    shown = sanitize(text)
    assert shown.isprintable()
    assert len(shown) <= 120


def test_the_first_refusals_are_logged_at_once_and_the_rest_is_counted() -> None:
    clock, lines = FakeClock(), list[str]()
    rate_limit = LogRateLimit(lines.append, clock)
    for _ in range(1000):
        rate_limit.add("refused a connection: it does not speak TLS")
    assert lines == ["refused a connection: it does not speak TLS"]
    clock.now_s += 11
    rate_limit.poll()
    assert lines[1:] == ["and 999 more such refusals"]


@given(st.lists(st.tuples(st.text(max_size=3), st.floats(0, 3)), max_size=300))
def test_refusals_are_logged_at_a_limited_rate(
    events: list[tuple[str, float]],
) -> None:
    clock, logged_s = FakeClock(), list[float]()
    rate_limit = LogRateLimit(lambda clause: logged_s.append(clock.now_s), clock)
    for text, pause_s in events:
        clock.now_s += pause_s
        rate_limit.add(text)
    for begin_s in logged_s:
        assert sum(begin_s <= at_s < begin_s + 10 for at_s in logged_s) <= 11


def test_after_a_quiet_time_refusals_are_logged_at_once_again() -> None:
    clock, lines = FakeClock(), list[str]()
    rate_limit = LogRateLimit(lines.append, clock)
    for _ in range(3):
        rate_limit.add("refused")
        clock.now_s += 60
    assert lines == ["refused"] * 3

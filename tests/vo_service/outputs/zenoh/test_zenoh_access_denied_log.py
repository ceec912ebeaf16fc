"""What is made of Zenoh's log, and that no stranger can fill ours."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vo_service.fakes import FakeClock
from vo_service.outputs.zenoh.access_denied_log import AccessDeniedParser, parse_line, sanitize
from vo_service.outputs.zenoh.log_capture import LogRateLimit

SESSION = "3b57c0fb217d7c04ac2566e74850a739"


def line(text: str, target: str = "zenoh_link_tls::unicast", level: str = "WARN") -> str:
    """As Zenoh writes it, colors and all."""
    return (
        f"\x1b[2m2026-11-21T16:35:58.828375Z\x1b[0m \x1b[33m {level}\x1b[0m acc-0 ThreadId(05) "
        f"\x1b[2m{target}\x1b[0m\x1b[2m:\x1b[0m {text}"
    )


def clause(refusals: AccessDeniedParser, text: str, **where: str) -> str:
    parsed = parse_line(line(text, **where))
    assert parsed is not None
    return refusals.describe(parsed)


@pytest.mark.parametrize(
    ("said", "understood"),
    [
        ("peer sent no certificates", "it shows no certificate"),
        ("invalid peer certificate: UnknownIssuer", "its certificate is from an unknown authority"),
        ("invalid peer certificate: certificate expired: verification", "has expired"),
        ("received corrupt message of type InvalidContentType", "it does not speak TLS"),
        ("something quite new", "something quite new"),
    ],
)
def test_a_failed_handshake_is_put_in_plain_words(said: str, understood: str) -> None:
    told = clause(AccessDeniedParser(), f"{said}. Hint: increase the system open file limit.")
    assert told.startswith("refused a connection: ")
    assert told.endswith(understood)


def test_a_message_held_back_names_who_sent_it_also_from_memory() -> None:
    where = {"target": "zenoh::net::routing::interceptor::access_control", "level": "TRACE"}
    subject = f"{SESSION} on Interface(lo)+CertCommonName(reader)+Transport(Tls)+{SESSION}"
    refusals, asked = AccessDeniedParser(), "Query (ingress) on kinect/command/reset"
    first = clause(refusals, f"{subject} is unauthorized to {asked}", **where)
    again = clause(refusals, f"Using cached result: {SESSION} is unauthorized to {asked}", **where)
    assert first == again == 'denied "reader": query on kinect/command/reset'


def test_what_is_allowed_or_only_not_passed_on_is_no_refusal() -> None:
    where = {"target": "zenoh::net::routing::interceptor::access_control", "level": "TRACE"}
    refusals, on = AccessDeniedParser(), f"{SESSION} on Interface(lo)+Transport(Tls)+{SESSION} is"
    assert clause(refusals, f"{on} authorized to Put (ingress) on a", **where) == ""
    assert clause(refusals, f"{on} unauthorized to Declare Queryable (egress) on a", **where) == ""


@pytest.mark.slow
@given(st.text())
def test_no_line_is_too_strange_to_read(text: str) -> None:
    parsed = parse_line(text)
    assert parsed is None or isinstance(AccessDeniedParser().describe(parsed), str)


@given(st.text())
def test_what_a_stranger_wrote_stays_on_one_line(text: str) -> None:
    shown = sanitize(text)
    assert shown.isprintable()
    assert len(shown) <= 120


def test_the_first_refusals_are_told_at_once_and_the_rest_is_counted() -> None:
    clock, told = FakeClock(), list[str]()
    gate = LogRateLimit(told.append, clock)
    for _ in range(1000):
        gate.add("refused a connection: it does not speak TLS")
    assert told == ["refused a connection: it does not speak TLS"]
    clock.now_s += 11
    gate.poll()
    assert told[1:] == ["and 999 more such refusals"]


@given(st.lists(st.tuples(st.text(max_size=3), st.floats(0, 3)), max_size=300))
def test_there_are_never_more_than_a_few_lines_in_ten_seconds(
    events: list[tuple[str, float]],
) -> None:
    clock, told_s = FakeClock(), list[float]()
    gate = LogRateLimit(lambda clause: told_s.append(clock.now_s), clock)
    for text, pause_s in events:
        clock.now_s += pause_s
        gate.add(text)
    for begin_s in told_s:
        assert sum(begin_s <= at_s < begin_s + 10 for at_s in told_s) <= 11


def test_after_a_quiet_time_it_tells_again() -> None:
    clock, told = FakeClock(), list[str]()
    gate = LogRateLimit(told.append, clock)
    for _ in range(3):
        gate.add("refused")
        clock.now_s += 60
    assert told == ["refused"] * 3

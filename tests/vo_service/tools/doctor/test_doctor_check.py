"""The order of the checks, what a failure skips, and the printed result."""

import io
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.vo_service.tools.doctor.doctor_fakes import make_context
from vo_service.tools.doctor.camera_checks import checks_for, requested_camera
from vo_service.tools.doctor.check import (
    Check,
    CheckContext,
    CheckResult,
    diagnosis_as_json,
    overall_verdict,
    run_checks,
)
from vo_service.tools.doctor.finding import CheckVerdict, Finding, failed, passed, warned
from vo_service.tools.doctor.printer import FindingPrinter

LONG = "one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen"


def fixed_check(name: str, finding: Finding, needs: tuple[str, ...] = ()) -> Check:
    """Make a check with a fixed finding."""
    return Check(name, lambda context: finding, needs)


def raise_unreadable(context: CheckContext) -> Finding:
    raise PermissionError(13, "Permission denied", "/proc/1/fd")


UNREADABLE = Check("unreadable", raise_unreadable)


class FakeTerminal(io.StringIO):
    """Terminal, or file, with a given encoding."""

    def __init__(self, encoding: str = "utf-8", is_terminal: bool = True) -> None:
        super().__init__()
        self._encoding, self._is_terminal = encoding, is_terminal

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the output."""
        return self._encoding

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._is_terminal


@contextmanager
def quiet(name: str) -> Iterator[None]:
    """Show nothing."""
    yield


def run(*checks: Check) -> list[CheckResult]:
    """Run the checks and return their results."""
    return list(run_checks(checks, make_context(), quiet))


def printed(screen: FakeTerminal, results: list[CheckResult]) -> str:
    """Print the results and return the text."""
    printer = FindingPrinter(screen, [result.name for result in results])
    for result in results:
        printer.print_result(result)
    printer.print_conclusion(results)
    return screen.getvalue()


@pytest.fixture(autouse=True)
def plain_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set up a terminal with 64 columns and without colors."""
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "64")


BAD = fixed_check("usb-speed", failed("12 Mbit/s", "use another port"))
GOOD = fixed_check("sensor", passed("Kinect 1414"))
DEPENDENT = fixed_check("first-frames", passed("yes"), ("sensor", "usb-speed"))
LAST = fixed_check("skew", passed("4 ms"), ("first-frames",))


def test_checks_that_need_a_failed_one_are_skipped_with_the_first_cause() -> None:
    results = run(GOOD, BAD, DEPENDENT, LAST)
    assert [result.finding.verdict for result in results] == ["pass", "fail", "skipped", "skipped"]
    assert [result.finding.text for result in results[2:]] == ["because usb speed failed"] * 2
    assert overall_verdict(results) is CheckVerdict.FAIL


def test_a_warning_skips_nothing() -> None:
    results = run(fixed_check("sensor", warned("480 Mbit/s", "do this")), DEPENDENT)
    assert results[1].finding.verdict is CheckVerdict.PASS
    assert overall_verdict(results) is CheckVerdict.PASS


def test_a_file_that_cannot_be_read_makes_one_result_unknown() -> None:
    (result,) = run_checks([UNREADABLE], make_context(), quiet)
    assert result.finding.verdict is CheckVerdict.UNKNOWN
    assert "/proc/1/fd" in result.finding.text


def test_the_json_has_every_check_under_the_same_keys() -> None:
    diagnosis = json.loads(json.dumps(diagnosis_as_json("freenect", run(GOOD, BAD, DEPENDENT))))
    assert (diagnosis["schema"], diagnosis["camera"], diagnosis["verdict"]) == (
        1, "freenect", "fail",
    )  # fmt: skip
    keys = {"name", "verdict", "text", "fix", "facts"}
    assert all(set(check) == keys for check in diagnosis["checks"])


@pytest.mark.parametrize("source", ["freenect", "openni2", "openni2:a.oni", "tum:desk"])
def test_each_check_comes_after_those_it_needs(source: str) -> None:
    before: set[str] = set()
    checks = checks_for(requested_camera(source))
    names = {check.name for check in checks}
    for check in checks:
        assert before.issuperset(names.intersection(check.needs)), check.name
        before.add(check.name)


def test_lines_are_aligned_and_the_fix_is_below() -> None:
    assert printed(FakeTerminal(), run(GOOD, BAD, DEPENDENT, LAST)) == (
        "  ✓ sensor        Kinect 1414\n"
        "  ✗ usb speed     12 Mbit/s\n"
        "                  fix: use another port\n"
        "  - not checked   first frames, skew (because usb speed failed)\n"
        "\n"
        "1 failed (usb speed), 2 not checked: fix this and re-run\n"
    )


def test_a_terminal_gets_no_line_that_is_too_long_and_a_log_a_line_for_each_check() -> None:
    results = run(fixed_check("sensor", failed(LONG, LONG)))
    lines = printed(FakeTerminal(), results).splitlines()
    assert len(lines) > 6
    assert max(len(line) for line in lines) <= 64
    assert lines[1].startswith(" " * 17)
    assert LONG in printed(FakeTerminal(is_terminal=False), results).splitlines()[0]


def test_a_stream_without_unicode_gets_ascii_symbols() -> None:
    text = printed(
        FakeTerminal("ascii"), run(GOOD, BAD, fixed_check("gravity", passed("9.81 m/s²")))
    )
    assert "  + sensor" in text
    assert "  x usb speed" in text
    assert text.isascii()


def test_colors_are_for_terminals_that_want_them(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "\x1b[" not in printed(FakeTerminal(), run(BAD))
    monkeypatch.setitem(os.environ, "NO_COLOR", "")
    assert "\x1b[31m" in printed(FakeTerminal(), run(BAD))
    assert "\x1b[" not in printed(FakeTerminal(is_terminal=False), run(BAD))


def test_the_conclusion_names_the_warnings() -> None:
    assert printed(FakeTerminal(), run(GOOD)).endswith("\nall checks passed\n")
    lost_packets = fixed_check("lost-packets", warned("3", "another port"))
    assert printed(FakeTerminal(), run(GOOD, lost_packets)).endswith(
        "\nit works, with warnings: lost packets\n"
    )

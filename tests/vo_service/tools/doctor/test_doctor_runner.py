"""The order of the checks, what one failure stops, and how it all looks."""

import io
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from tests.vo_service.tools.doctor.doctor_fakes import make_capture, make_context, make_sensor
from vo_service.tools.doctor.checks import checks_for
from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import CheckVerdict, Finding, failed, passed, warned
from vo_service.tools.doctor.printer import FindingPrinter
from vo_service.tools.doctor.runner import (
    CheckResult,
    diagnosis_as_json,
    overall_verdict,
    run_checks,
)
from vo_service.tools.doctor.usb_probe import OpenError

LONG = "one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen"


@dataclass(frozen=True)
class FixedCheck:
    """Finds what it is told to."""

    name: str
    finding: Finding
    needs: tuple[str, ...] = ()

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        return self.finding


class UnreadableCheck:
    """Meets a file that it may not read."""

    name = "unreadable"
    needs: tuple[str, ...] = ()

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        raise PermissionError(13, "Permission denied", "/proc/1/fd")


class FakeTerminal(io.StringIO):
    """A terminal of a given encoding."""

    def __init__(self, encoding: str = "utf-8", is_terminal: bool = True) -> None:
        super().__init__()
        self._encoding, self._is_terminal = encoding, is_terminal

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Of what is written."""
        return self._encoding

    def isatty(self) -> bool:
        """Whether it has columns and colors."""
        return self._is_terminal


@contextmanager
def quiet(name: str) -> Iterator[None]:
    """Show nothing."""
    yield


def run(*checks: FixedCheck) -> list[CheckResult]:
    """What these checks come to."""
    return list(run_checks(checks, make_context(), quiet))


def shown(screen: FakeTerminal, found: list[CheckResult]) -> str:
    """What a person sees."""
    printer = FindingPrinter(screen, [result.name for result in found])
    for result in found:
        printer.print_result(result)
    printer.print_conclusion(found)
    return screen.getvalue()


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal of 64 columns without colors."""
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "64")


BAD = FixedCheck("usb-speed", failed("12 Mbit/s", "use another port"))
GOOD = FixedCheck("sensor", passed("Kinect 1414"))
DEPENDENT = FixedCheck("first-frames", passed("yes"), ("sensor", "usb-speed"))
LAST = FixedCheck("skew", passed("4 ms"), ("first-frames",))


def test_what_needs_a_failed_check_is_not_run_and_names_the_first_cause() -> None:
    found = run(GOOD, BAD, DEPENDENT, LAST)
    assert [result.finding.verdict for result in found] == ["pass", "fail", "skipped", "skipped"]
    assert [result.finding.text for result in found[2:]] == ["since usb speed failed"] * 2
    assert overall_verdict(found) is CheckVerdict.FAIL


def test_a_warning_stops_nothing() -> None:
    found = run(FixedCheck("sensor", warned("hm", "do this")), DEPENDENT)
    assert found[1].finding.verdict is CheckVerdict.PASS
    assert overall_verdict(found) is CheckVerdict.PASS


def test_a_file_that_cannot_be_read_leaves_one_answer_open() -> None:
    (found,) = run_checks([UnreadableCheck()], make_context(), quiet)
    assert found.finding.verdict is CheckVerdict.UNKNOWN
    assert "/proc/1/fd" in found.finding.text


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
    for check in checks_for(source):
        assert before.issuperset(check.needs), check.name
        before.add(check.name)


def test_a_camera_without_permission_is_not_opened() -> None:
    def watch() -> object:
        raise AssertionError("it must not be opened")

    machine = make_context([make_sensor(open_error=OpenError.PERMISSION)])
    machine._probe_stream = watch  # type: ignore[assignment]
    found = list(run_checks(checks_for("freenect")[1:], machine, quiet))
    skipped = {result.name for result in found if result.finding.verdict is CheckVerdict.SKIPPED}
    assert {"sole-use", "first-frames", "frame-rate", "gravity"} <= skipped


@pytest.mark.subprocess
@pytest.mark.usefixtures("real_libfreenect")
def test_a_good_machine_passes_every_check() -> None:
    found = list(
        run_checks(checks_for("freenect"), make_context([make_sensor()], make_capture()), quiet)
    )
    assert overall_verdict(found) is CheckVerdict.PASS
    assert "skipped" not in [result.finding.verdict for result in found]


def test_lines_are_aligned_and_the_fix_is_below() -> None:
    assert shown(FakeTerminal(), run(GOOD, BAD, DEPENDENT, LAST)) == (
        "  ✓ sensor        Kinect 1414\n"
        "  ✗ usb speed     12 Mbit/s\n"
        "                  fix: use another port\n"
        "  - not checked   first frames, skew (since usb speed failed)\n"
        "\n"
        "1 failed (usb speed), 2 not checked: mend that, run it again\n"
    )


def test_a_terminal_gets_no_line_that_is_too_long() -> None:
    found = run(FixedCheck("sensor", failed(LONG, LONG)))
    lines = shown(FakeTerminal(), found).splitlines()
    assert len(lines) > 6
    assert max(len(line) for line in lines) <= 64
    assert lines[1].startswith(" " * 17)


def test_a_log_keeps_each_check_on_one_line() -> None:
    found = run(FixedCheck("sensor", failed(LONG, LONG)))
    assert LONG in shown(FakeTerminal(is_terminal=False), found).splitlines()[0]


def test_a_stream_without_unicode_gets_plain_marks() -> None:
    text = shown(FakeTerminal("ascii"), run(GOOD, BAD, FixedCheck("gravity", passed("9.81 m/s²"))))
    assert "  + sensor" in text
    assert "  x usb speed" in text
    assert text.isascii()


def test_colors_are_for_terminals_that_want_them(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "\x1b[" not in shown(FakeTerminal(), run(BAD))
    monkeypatch.setitem(os.environ, "NO_COLOR", "")
    assert "\x1b[31m" in shown(FakeTerminal(), run(BAD))
    assert "\x1b[" not in shown(FakeTerminal(is_terminal=False), run(BAD))


def test_the_conclusion_names_what_to_look_at() -> None:
    assert shown(FakeTerminal(), run(GOOD)).endswith("\nall is well\n")
    hm = FixedCheck("lost-packets", warned("3", "another port"))
    assert shown(FakeTerminal(), run(GOOD, hm)).endswith("\nit works; look at lost packets\n")

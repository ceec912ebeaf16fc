"""Progress for a person at a terminal; in a log, only what is worth a line."""

import io
import os
import pty
import re

import pytest

from tests.vo_service.fakes import FakeClock
from tests.waiting import wait_until
from vo_service import terminal as terminal_module
from vo_service.logs import log_to_stderr
from vo_service.terminal import Terminal, clear_line


class CapturedTerminal(io.StringIO):
    """A terminal that keeps what was drawn."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    clock = FakeClock()
    monkeypatch.setattr(terminal_module, "time", clock)
    return clock


def test_without_a_terminal_there_is_no_progress() -> None:
    log = io.StringIO()
    terminal = Terminal(log)
    terminal.show("busy")
    terminal.progress("frame", 1, 1)
    terminal.clear()
    assert log.getvalue() == ""


def test_without_a_terminal_a_message_is_a_log_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with log_to_stderr():
        Terminal().write_line("Rerun: http://127.0.0.1:9090")
    assert capsys.readouterr().err == "kinect-vo: info: Rerun: http://127.0.0.1:9090\n"


def test_on_a_terminal_a_message_is_a_plain_line() -> None:
    screen = CapturedTerminal()
    Terminal(screen).write_line("Rerun: http://127.0.0.1:9090")
    assert screen.getvalue() == "Rerun: http://127.0.0.1:9090\n"


def test_a_progress_line_is_overwritten_and_cleared() -> None:
    screen = CapturedTerminal()
    terminal = Terminal(screen)
    terminal.show("one")
    terminal.show("two")
    terminal.clear()
    assert screen.getvalue() == "\r\x1b[Kone\r\x1b[Ktwo\r\x1b[K"


def test_a_line_that_was_never_drawn_is_not_cleared() -> None:
    screen = CapturedTerminal()
    terminal = Terminal(screen)
    terminal.clear()
    terminal.show("one")
    terminal.clear()
    terminal.clear()
    assert screen.getvalue() == "\r\x1b[Kone\r\x1b[K"


def test_progress_is_drawn_ten_times_a_second_and_at_the_end(clock: FakeClock) -> None:
    screen = CapturedTerminal()
    terminal = Terminal(screen)
    for done in range(1, 64):
        clock.now_s += 1 / 32
        terminal.progress("frame", done, 63)
    drawn = screen.getvalue().split("\r\x1b[K")[1:]
    assert drawn[:2] == ["frame 1/63 (2%)", "frame 5/63 (8%)"]
    assert drawn[-1] == "frame 63/63 (100%)"
    assert len(drawn) == 17


def test_progress_without_a_total_only_counts(clock: FakeClock) -> None:
    screen = CapturedTerminal()
    Terminal(screen).progress("frame", 7, None)
    assert screen.getvalue() == "\r\x1b[Kframe 7"


def test_progress_is_drawn_on_a_real_terminal() -> None:
    try:
        ours, theirs = pty.openpty()
    except OSError as error:
        pytest.skip(f"no pseudo-terminal to be had here (is /dev/pts mounted?): {error}")
    with os.fdopen(theirs, "w") as stream:
        Terminal(stream).show("busy")
        assert os.read(ours, 100) == b"\r\x1b[Kbusy"
    os.close(ours)


def test_the_line_is_cleared_only_on_a_terminal() -> None:
    screen, log = CapturedTerminal(), io.StringIO()
    clear_line(screen)
    clear_line(log)
    assert (screen.getvalue(), log.getvalue()) == ("\r\x1b[K", "")


def test_quick_steps_are_not_logged(capsys: pytest.CaptureFixture[str]) -> None:
    with log_to_stderr(), Terminal().busy("loading") as busy:
        busy.progress_callback("frame")(1, 2)
    assert capsys.readouterr().err == ""


def test_slow_steps_are_logged_with_their_duration(
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(terminal_module, "SLOW_AFTER_S", 0.01)
    with log_to_stderr(), Terminal().busy("compiling"):
        wait_until(lambda: caplog.messages, "a log line")
    begin, end = capsys.readouterr().err.splitlines()
    assert begin == "kinect-vo: info: compiling ..."
    assert re.fullmatch(r"kinect-vo: info: compiling: done after \d+\.\d s", end)

"""Progress for a person at a terminal; in a log, only what is worth a line."""

import io
import math
import os
import pty
import re
import select
from contextlib import suppress

import pytest

from tests.vo_service.captured_terminal import CapturedTerminal
from tests.vo_service.fakes import FakeClock
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until
from vo_service import terminal as terminal_module
from vo_service.terminal import Terminal, announce_if_slow, clear_line, log_to_stderr


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
    assert screen.drawn == ["", "one", "two", ""]


def test_a_line_that_was_never_drawn_is_not_cleared() -> None:
    screen = CapturedTerminal()
    Terminal(screen).clear()
    assert screen.getvalue() == ""


def test_a_line_does_not_wrap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    screen = CapturedTerminal()
    Terminal(screen).show("a text of more than twenty letters")
    assert screen.drawn[-1] == "a text of more than…"


def test_the_cursor_stays_visible_and_brackets_are_no_markup() -> None:
    screen = CapturedTerminal()
    Terminal(screen).show("[red]5[/red]")
    assert "[red]5[/red]" in screen.getvalue()
    assert screen.getvalue().rindex("\x1b[?25h") > screen.getvalue().rindex("\x1b[?25l")


def test_progress_is_drawn_ten_times_a_second_and_at_the_end(clock: FakeClock) -> None:
    screen = CapturedTerminal()
    terminal = Terminal(screen)
    for done in range(1, 64):
        clock.now_s += 1 / 32
        terminal.progress("frame", done, 63)
    counts = [text.partition(")")[0] for text in screen.drawn if text]
    assert counts[:2] == ["frame 1/63 (2%", "frame 5/63 (8%"]
    assert counts[-1] == "frame 63/63 (100%"
    assert len(counts) == 17


def test_progress_without_a_total_only_counts(clock: FakeClock) -> None:
    screen = CapturedTerminal()
    Terminal(screen).progress("frame", 7, None)
    assert screen.drawn[-1] == "frame 7"


def test_received_bytes_are_shown_with_their_total(clock: FakeClock) -> None:
    screen = CapturedTerminal()
    terminal = Terminal(screen)
    for done in (100_000_000, 200_000_000):
        clock.now_s += 1.0
        terminal.progress_bytes("fr1/xyz", done, 400_000_000)
    assert screen.drawn[-1].startswith("fr1/xyz")
    assert "200.0/400.0 MB" in screen.drawn[-1]


def test_no_color_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    for no_color in ("", "1"):
        monkeypatch.setenv("NO_COLOR", no_color)
        screen = CapturedTerminal()
        Terminal(screen).progress("frame", 1, 2)
        assert ("\x1b[3" in screen.getvalue()) == (not no_color)


def test_progress_is_drawn_on_a_real_terminal() -> None:
    try:
        ours, theirs = pty.openpty()
    except OSError as error:
        pytest.skip(f"no pseudo-terminal to be had here (is /dev/pts mounted?): {error}")
    with os.fdopen(theirs, "w") as stream:
        Terminal(stream).show("busy")
        seen = b""
        while b"busy" not in seen and select.select([ours], [], [], DEFAULT_TIMEOUT_S)[0]:
            seen += os.read(ours, 1000)
        assert b"busy" in seen
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


def test_a_log_gets_a_line_of_progress_now_and_then(caplog: pytest.LogCaptureFixture) -> None:
    terminal = Terminal(io.StringIO(), log_period_s=0.0)
    terminal.progress("recording: frame", 3, 30)
    silent = Terminal(io.StringIO(), log_period_s=math.inf)
    silent.progress("run: frame", 3, 30)
    assert caplog.messages == ["recording: frame 3/30 (10%)"]


def test_an_interrupted_wait_is_not_announced_as_done(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(terminal_module, "SLOW_AFTER_S", 0.0)
    with suppress(KeyboardInterrupt), announce_if_slow("waiting"):
        wait_until(lambda: caplog.messages, "a log line")
        raise KeyboardInterrupt
    assert caplog.messages == ["waiting ..."]

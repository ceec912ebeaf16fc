"""The log as a person sees it, and as the journal does."""

import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator

import pytest

from tests.vo_service.fakes import FakeClock
from vo_service.terminal import (
    MAX_REPEATS,
    MAX_TRACKED_LINES,
    REPEAT_PERIOD_S,
    RepeatedLineFilter,
    log_to_stderr,
    set_log_level,
)

logger = logging.getLogger("test")


@pytest.fixture
def root_level() -> Iterator[None]:
    """The level is as before, afterwards."""
    before = logging.getLogger().level
    yield
    logging.getLogger().setLevel(before)


def journal_of(code: str, *, is_journal: bool = True) -> list[str]:
    """The lines of a program whose stderr is, or only seems to be, the journal."""
    program = (
        f"import logging\nfrom vo_service.terminal import *\nwith log_to_stderr():\n    {code}\n"
    )
    with tempfile.TemporaryFile("w+") as stream:
        state = os.fstat(stream.fileno())
        inode = state.st_ino if is_journal else state.st_ino + 1
        environment = {**os.environ, "JOURNAL_STREAM": f"{state.st_dev}:{inode}"}
        command = [sys.executable, "-c", program]
        subprocess.run(command, stderr=stream, env=environment, check=True, timeout=100)
        stream.seek(0)
        return stream.read().splitlines()


def test_a_terminal_line_has_program_and_level(capsys: pytest.CaptureFixture[str]) -> None:
    with log_to_stderr():
        logger.warning("%s is gone", "the camera")
    assert capsys.readouterr().err == "kinect-vo: warning: the camera is gone\n"


@pytest.mark.subprocess
def test_a_journal_line_has_the_level_as_a_number() -> None:
    code = "set_log_level('debug'); l = logging.getLogger('x'); l.error('e'); l.warning('w'); "
    lines = journal_of(code + "l.info('i'); l.debug('d'); l.critical('c')")
    assert lines == ["<3>e", "<4>w", "<6>i", "<7>d", "<3>c"]


@pytest.mark.subprocess
def test_an_announcement_is_shown_at_the_default_level() -> None:
    code = "from vo_service.terminal import announce; announce('shown'); "
    assert journal_of(code + "set_log_level('error'); announce('hidden')") == ["<6>shown"]


@pytest.mark.subprocess
def test_every_line_of_a_long_message_has_its_level() -> None:
    assert journal_of(r"logging.getLogger('x').error('one\ntwo')") == ["<3>one", "<3>two"]


@pytest.mark.subprocess
def test_a_child_that_only_inherits_the_variable_writes_terminal_lines() -> None:
    lines = journal_of("logging.getLogger('x').error('e')", is_journal=False)
    assert lines == ["kinect-vo: error: e"]


@pytest.mark.usefixtures("root_level")
def test_the_level_filters_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with log_to_stderr():
        logger.info("hidden")
        set_log_level("info")
        logger.info("shown")
        set_log_level("error")
        logger.warning("hidden again")
    assert capsys.readouterr().err == "kinect-vo: info: shown\n"


def test_a_repeated_line_is_limited(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with log_to_stderr():
        for _ in range(100):
            logger.warning("the same")
        logger.warning("another")
    lines = capsys.readouterr().err.splitlines()
    assert lines[:-2] == ["kinect-vo: warning: the same"] * (MAX_REPEATS - 1)
    assert lines[-2].endswith("the same (repeated: hidden for 60 s)")
    assert lines[-1] == "kinect-vo: warning: another"


def test_after_a_while_a_repeated_line_is_shown_with_the_hidden_count() -> None:
    clock = FakeClock()
    limit = RepeatedLineFilter(clock)
    for _ in range(MAX_REPEATS + 7):
        limit.suffix_or_none("the same")
    clock.now_s += REPEAT_PERIOD_S
    assert limit.suffix_or_none("the same") == " (7 repeats were hidden)"
    assert limit.suffix_or_none("the same") == ""


def test_an_occasional_line_is_always_shown() -> None:
    clock = FakeClock()
    limit = RepeatedLineFilter(clock)
    for _ in range(50):
        clock.now_s += REPEAT_PERIOD_S
        assert limit.suffix_or_none("now and then") == ""


def test_the_memory_for_repeated_lines_is_limited() -> None:
    limit = RepeatedLineFilter()
    for number in range(10 * MAX_TRACKED_LINES):
        assert limit.suffix_or_none(f"line {number}") == ""
    assert len(limit._counts) == MAX_TRACKED_LINES

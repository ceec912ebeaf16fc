"""The log on stderr: lines for people, or lines with a syslog level for the systemd journal."""

import logging
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from typing import TextIO

from vo_service.terminal import clear_line

# The same line is shown this often per period; further repeats are only counted.
MAX_REPEATS = 5
REPEAT_PERIOD_S = 60.0
# Number of lines to count at once; the oldest is dropped first.
MAX_TRACKED_LINES = 200

# Levels of syslog(3), which the journal reads at the start of a line; see sd-daemon(3).
_SYSLOG_LEVELS = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_SYSLOG_DEBUG = 7


@contextmanager
def log_to_stderr() -> Iterator[None]:
    """Log to stderr while the block runs, at level warning until `set_log_level`."""
    is_journal = is_journal_stream(sys.stderr)
    handler = _StderrHandler()
    handler.setFormatter(_JournalFormatter() if is_journal else _TerminalFormatter())
    root = logging.getLogger()
    before = root.level
    root.addHandler(handler)
    set_log_level("warning")
    try:
        yield
    finally:
        root.removeHandler(handler)
        root.setLevel(before)


def set_log_level(level: str) -> None:
    """Set the least level to log: "debug", "info", "warning" or "error".

    What was found in a bag is announced, as by `terminal.announce`: also at level warning.
    """
    root = logging.getLogger()
    root.setLevel(level.upper())
    announces = root.level <= logging.WARNING
    logging.getLogger("drivers.recording_camera").setLevel(
        logging.INFO if announces else root.level
    )


def is_journal_stream(stream: TextIO) -> bool:
    """Whether systemd has connected a stream to the journal; see JOURNAL_STREAM in systemd.exec(5).

    The variable alone is not enough: a child of the service inherits it with another stderr.
    """
    try:
        state = os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or no file at all
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{state.st_dev}:{state.st_ino}"


@dataclass
class _LineCount:
    since_s: float
    count: int = 0


class RepeatedLineFilter:
    """Hides a line that repeats too often, so that one fault does not fill the log."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._counts: dict[str, _LineCount] = {}

    def suffix_or_none(self, text: str) -> str | None:
        """Count a line and return the text to append to it.

        Returns:
            A note on hidden repeats, usually ""; None: hide the line.
        """
        now_s = self._now_s()
        seen = self._counts.get(text)
        hidden = 0
        if seen is None or now_s - seen.since_s >= REPEAT_PERIOD_S:
            hidden = max(0, seen.count - MAX_REPEATS) if seen else 0
            seen = self._start_count(text, now_s)
        seen.count += 1
        if seen.count > MAX_REPEATS:
            return None
        if seen.count == MAX_REPEATS:
            return f" (repeated: hidden for {REPEAT_PERIOD_S:.0f} s)"
        return f" ({hidden} repeats were hidden)" if hidden else ""

    def _start_count(self, text: str, now_s: float) -> _LineCount:
        self._counts.pop(text, None)
        if len(self._counts) >= MAX_TRACKED_LINES:
            del self._counts[next(iter(self._counts))]
        seen = self._counts[text] = _LineCount(now_s)
        return seen


class _StderrHandler(logging.StreamHandler[TextIO]):
    """Writes to stderr; clears a progress line first."""

    def __init__(self) -> None:
        super().__init__()
        self._repeats = RepeatedLineFilter()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            message = record.getMessage()
        except (TypeError, ValueError):  # wrong arguments: report, do not raise
            self.handleError(record)
            return
        note = self._repeats.suffix_or_none(message)
        if note is None:
            return
        shown = copy(record)  # other handlers see the record as it is
        shown.msg, shown.args = f"{message}{note}", ()
        clear_line(self.stream)
        super().emit(shown)


class _TerminalFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return f"kinect-vo: {record.levelname.lower()}: {super().format(record)}"


class _JournalFormatter(logging.Formatter):
    """Starts each line with its level: the journal adds the program, and splits at line ends."""

    def format(self, record: logging.LogRecord) -> str:
        level = _syslog_level(record.levelno)
        return "\n".join(f"<{level}>{line}" for line in super().format(record).splitlines())


def _syslog_level(level: int) -> int:
    return next((syslog for least, syslog in _SYSLOG_LEVELS if level >= least), _SYSLOG_DEBUG)

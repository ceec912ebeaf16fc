"""The log on stderr: lines for a person, or, in the systemd journal, lines with their level."""

import logging
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from typing import TextIO

from vo_service.terminal import wipe

# The same line is shown so often in so long a time; the rest is counted.
MOST_IN_PERIOD = 5
PERIOD_S = 60.0
# Lines to remember at once; the one that began first is forgotten.
LINES_REMEMBERED = 200

# Levels of syslog(3), which the journal takes from the start of a line; see sd-daemon(3).
_SYSLOG_LEVELS = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_SYSLOG_DEBUG = 7


@contextmanager
def log_to_stderr() -> Iterator[None]:
    """While the block runs; another call in the same process begins afresh."""
    is_journal = goes_to_journal(sys.stderr)
    handler = _Handler()
    handler.setFormatter(_JournalLine() if is_journal else _Line())
    root = logging.getLogger()
    before = root.level
    root.addHandler(handler)
    root.setLevel(logging.WARNING)
    try:
        yield
    finally:
        root.removeHandler(handler)
        root.setLevel(before)


def set_level(level: str) -> None:
    """Show what is at least as grave as "debug", "info", "warning" or "error"."""
    logging.getLogger().setLevel(level.upper())


def goes_to_journal(stream: TextIO) -> bool:
    """Whether systemd has connected a stream to the journal, as systemd.exec(5) says to find out.

    The variable alone is no sign: a child of the service inherits it with another stderr.
    """
    try:
        state = os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or no file at all
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{state.st_dev}:{state.st_ino}"


@dataclass
class _Seen:
    since_s: float
    count: int = 0


class RepeatLimit:
    """Keeps a fault that comes again and again from filling the log with one line."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._seen: dict[str, _Seen] = {}

    def judge(self, text: str) -> str | None:
        """What to put behind this line, mostly ""; None: do not show it."""
        now_s = self._clock()
        seen = self._seen.get(text)
        hidden = 0
        if seen is None or now_s - seen.since_s >= PERIOD_S:
            hidden = max(0, seen.count - MOST_IN_PERIOD) if seen else 0
            seen = self._begin(text, now_s)
        seen.count += 1
        if seen.count > MOST_IN_PERIOD:
            return None
        if seen.count == MOST_IN_PERIOD:
            return f" (again: not shown any more for {PERIOD_S:.0f} s)"
        return f" (and {hidden} times that were not shown)" if hidden else ""

    def _begin(self, text: str, now_s: float) -> _Seen:
        self._seen.pop(text, None)
        if len(self._seen) >= LINES_REMEMBERED:
            del self._seen[next(iter(self._seen))]
        seen = self._seen[text] = _Seen(now_s)
        return seen


class _Handler(logging.StreamHandler[TextIO]):
    """To stderr, on a line of its own even where progress is drawn."""

    def __init__(self) -> None:
        super().__init__()
        self._repeats = RepeatLimit()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            message = record.getMessage()
        except (TypeError, ValueError):  # arguments that do not fit; reported, never raised
            self.handleError(record)
            return
        note = self._repeats.judge(message)
        if note is None:
            return
        shown = copy(record)  # other handlers see the record as it is
        shown.msg, shown.args = f"{message}{note}", ()
        wipe(self.stream)
        super().emit(shown)


class _Line(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return f"kinect-vo: {record.levelname.lower()}: {super().format(record)}"


class _JournalLine(logging.Formatter):
    """The journal knows the program and takes each line for an entry, with a level of its own."""

    def format(self, record: logging.LogRecord) -> str:
        level = _syslog_level(record.levelno)
        return "\n".join(f"<{level}>{line}" for line in super().format(record).splitlines())


def _syslog_level(level: int) -> int:
    return next((syslog for least, syslog in _SYSLOG_LEVELS if level >= least), _SYSLOG_DEBUG)

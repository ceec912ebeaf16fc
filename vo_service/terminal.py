"""What people read: the log on stderr, the progress of slow work, and columns of figures.

Progress is a line that is redrawn on a terminal, or lines of the log. The line is drawn by rich,
which is imported when the first line is drawn.
"""

import logging
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

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

    What was found in a bag is announced, as by `announce`: also at level warning.
    """
    root = logging.getLogger()
    root.setLevel(level.upper())
    announces = root.level <= logging.WARNING
    logging.getLogger("drivers.playback").setLevel(logging.INFO if announces else root.level)


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
        levels = (syslog for least, syslog in _SYSLOG_LEVELS if record.levelno >= least)
        level = next(levels, _SYSLOG_DEBUG)
        return "\n".join(f"<{level}>{line}" for line in super().format(record).splitlines())


# Slow work is logged after this time, so that a user never waits 2 s without a reason.
SLOW_AFTER_S = 1.5

# This logger has a level of its own: announcements are shown even if the root's level is higher.
_logger = logging.getLogger("kinect-vo.announcements")
REDRAW_S = 0.1
LOG_PERIOD_S = 10.0
BUSY_REDRAWS_PER_S = 4
BAR_WIDTH = 20
CLEAR_LINE = "\r\x1b[K"
_logger.setLevel(logging.INFO)


def one_line(text: str) -> str:
    """Replace line ends and other control characters, which names of files may have, by spaces."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f]+", " ", text)


def announce(text: str) -> None:
    """Log a line at level info. It is shown unless ``log.level = "error"``."""
    if logging.getLogger().level <= logging.WARNING:
        _logger.info("%s", text)


@contextmanager
def announce_if_slow(label: str) -> Iterator[None]:
    """Log a line if the block is slow, and another when it has ended without an exception."""
    begin_s = time.monotonic()
    was_announced = threading.Event()

    def announce_begin() -> None:
        was_announced.set()
        announce(f"{label} ...")

    timer = threading.Timer(SLOW_AFTER_S, announce_begin)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
    if was_announced.is_set():
        announce(f"{label}: done after {time.monotonic() - begin_s:.1f} s")


def make_console(stream: TextIO, width: int | None = None) -> "Console":
    """Make rich's console of a stream. It has colors on a terminal, unless NO_COLOR is set.

    Args:
        width: Columns; None: those of the terminal.
    """
    from rich.console import Console

    has_color = stream.isatty() and not os.environ.get("NO_COLOR")
    return Console(
        file=stream,
        width=width,
        force_terminal=stream.isatty(),
        color_system="auto" if has_color else None,
        markup=False,
        emoji=False,
        highlight=False,
    )


def clear_line(stream: TextIO) -> None:
    """Clear the line of the cursor, if the stream is a terminal."""
    if stream.isatty():
        stream.write(CLEAR_LINE)
        stream.flush()


class _LineKind(Enum):
    """What a line shows beside its text."""

    TEXT = "nothing"
    COUNT = "a bar and the remaining time"
    BYTES = "a bar, bytes, their rate and the remaining time"
    BUSY = "a spinner and the elapsed time"


class Terminal:
    """One line on stderr that is redrawn in place, if stderr is a terminal; else lines of a log."""

    def __init__(self, stream: TextIO | None = None, log_period_s: float = LOG_PERIOD_S) -> None:
        """Draw nothing yet.

        Args:
            stream: Where to write; None: stderr.
            log_period_s: A log gets a line of progress this often, s.
        """
        self._log_period_s = log_period_s
        self._stream = stream or sys.stderr
        self._is_log = not self._stream.isatty()
        self._drawn_s = time.monotonic() if self._is_log else 0.0
        self._kind = _LineKind.TEXT
        self._line: Progress | None = None

    def show(self, text: str) -> None:
        """Replace the line by a text. In a log, do nothing."""
        self._draw(_LineKind.TEXT, text)

    def progress(self, label: str, done: int, total: int | None) -> None:
        """Replace the line by a count, at most ten times a second. A log gets a line now and then.

        Args:
            total: Count at the end; None: unknown.
        """
        if self._is_due(done == total):
            text = f"{label} {done}/{total} ({done / total:.0%})" if total else f"{label} {done}"
            if self._is_log:
                announce(text)
            self._draw(_LineKind.COUNT if total else _LineKind.TEXT, text, done, total)

    def progress_bytes(self, label: str, done: int, total: int | None) -> None:
        """Replace the line by received bytes and their rate, at most ten times a second.

        Args:
            done: Bytes so far. Those at the first call do not count for the rate.
            total: Bytes at the end; None: unknown.
        """
        if self._is_due(done == total):
            self._draw(_LineKind.BYTES, label, done, total)

    def write_line(self, text: str) -> None:
        """Write a permanent line; in a log, a line of level info."""
        if self._is_log:
            announce(text)
            return
        self.clear()
        self._stream.write(f"{text}\n")
        self._stream.flush()

    @contextmanager
    def busy(self, label: str) -> Iterator["BusyIndicator"]:
        """Show a line that counts the seconds while the block runs.

        A log gets a line if the block is slow, and another when it has ended.
        """
        busy = BusyIndicator(lambda text: self._draw(_LineKind.BUSY, f"{label}{text}"))
        if self._is_log:
            with announce_if_slow(label):
                yield busy
            return
        self._draw(_LineKind.BUSY, label)
        try:
            yield busy
        finally:
            self.clear()

    def clear(self) -> None:
        """Clear the line."""
        line, self._line = self._line, None
        if line is not None:
            line.stop()

    def _is_due(self, is_last: bool) -> bool:
        """Whether to draw now: ten times a second, and at the end. A log gets fewer lines."""
        now_s = time.monotonic()
        period_s = self._log_period_s if self._is_log else REDRAW_S
        if now_s - self._drawn_s < period_s and (self._is_log or not is_last):
            return False
        self._drawn_s = now_s
        return True

    def _draw(self, kind: _LineKind, text: str, done: int = 0, total: int | None = None) -> None:
        if self._is_log:
            return
        line = self._line
        if line is None or kind is not self._kind:
            self.clear()
            line = _start_line(self._stream, kind)
            line.add_task(text, completed=done, total=total)
            self._kind, self._line = kind, line
        (task,) = line.task_ids
        line.update(task, description=text, completed=done, total=total, refresh=True)


class BusyIndicator:
    """The detail behind the label of a busy line: the present step."""

    def __init__(self, draw: Callable[[str], None]) -> None:
        """Set the function that draws the line with this text behind its label."""
        self._draw = draw

    def set_detail(self, text: str) -> None:
        """Set the present step, shown behind the label."""
        self._draw(f": {text}")

    def progress_callback(self, what: str) -> Callable[[int, int], None]:
        """Return a function of (done, total) that shows the count of `what` as the detail."""
        return lambda done, total: self.set_detail(f"{what} {done}/{total}")


def _start_line(stream: TextIO, kind: _LineKind) -> "Progress":
    """Start an empty line. Only a busy line redraws itself, in a thread."""
    from rich import progress
    from rich.table import Column

    text = progress.TextColumn(
        "{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis")
    )
    bar, remaining = progress.BarColumn(BAR_WIDTH), progress.TimeRemainingColumn()
    columns: dict[_LineKind, tuple[progress.ProgressColumn, ...]] = {
        _LineKind.TEXT: (text,),
        _LineKind.COUNT: (text, bar, remaining),
        _LineKind.BYTES: (
            text, bar, progress.DownloadColumn(), progress.TransferSpeedColumn(), remaining,
        ),
        _LineKind.BUSY: (progress.SpinnerColumn(), text, progress.TimeElapsedColumn()),
    }  # fmt: skip
    line = progress.Progress(
        *columns[kind],
        console=make_console(stream),
        auto_refresh=kind is _LineKind.BUSY,
        refresh_per_second=BUSY_REDRAWS_PER_S,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    line.start()
    line.console.show_cursor()  # it must not stay hidden if the process is killed
    return line


def format_columns(rows: list[tuple[str, str]]) -> str:
    """Format rows of label and value as two aligned columns."""
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"{label:<{width}}  {value}".rstrip() for label, value in rows)


def format_mm(value_m: float | None) -> str:
    """Format a length as millimeters, for a column; "-" for None."""
    return f"{'-':>9}   " if value_m is None else f"{1e3 * value_m:9.2f} mm"

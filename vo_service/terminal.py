"""Progress: a live line on a terminal, or log lines for slow work."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

# Slow work is logged after this time, so that a user never waits 2 s without a reason.
SLOW_AFTER_S = 1.5

# This logger has a level of its own: announcements are shown even if the root's level is higher.
_logger = logging.getLogger("kinect-vo.announcements")
REDRAW_S = 0.1
BUSY_REDRAW_S = 0.5
CLEAR_LINE = "\r\x1b[K"
_logger.setLevel(logging.INFO)


def announce(text: str) -> None:
    """Log a line at level info. It is shown unless ``log.level = "error"``."""
    if logging.getLogger().level <= logging.WARNING:
        _logger.info("%s", text)


@contextmanager
def announce_if_slow(label: str) -> Iterator[None]:
    """Log a line if the block is slow, and another when it has ended.

    Args:
        label: Text of both lines.
    """
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


def clear_line(stream: TextIO) -> None:
    """Clear the line of the cursor, if the stream is a terminal."""
    if stream.isatty():
        stream.write(CLEAR_LINE)
        stream.flush()


class Terminal:
    """One line on stderr that is redrawn in place, if stderr is a terminal."""

    def __init__(self, stream: TextIO | None = None) -> None:
        """Draw nothing yet.

        Args:
            stream: Where to write; None: stderr.
        """
        self._stream = stream or sys.stderr
        self._is_log = not self._stream.isatty()
        self._drawn_s = 0.0
        self._is_drawn = False

    def show(self, text: str) -> None:
        """Replace the line by a text. In a log, do nothing."""
        if self._is_log:
            return
        self._stream.write(f"{CLEAR_LINE}{text}")
        self._stream.flush()
        self._is_drawn = True

    def progress(self, label: str, done: int, total: int | None) -> None:
        """Replace the line by a count, at most ten times a second.

        Args:
            label: What is counted.
            done: Count so far.
            total: Count at the end; None: unknown.
        """
        now_s = time.monotonic()
        if now_s - self._drawn_s < REDRAW_S and done != total:
            return
        self._drawn_s = now_s
        self.show(f"{label} {done}/{total} ({done / total:.0%})" if total else f"{label} {done}")

    def progress_callback(self, label: str) -> Callable[[int, int], None]:
        """Return a function of (done, total) that calls `progress` with this label."""
        return lambda done, total: self.progress(label, done, total)

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
        busy = BusyIndicator(self, label)
        if self._is_log:
            with announce_if_slow(label):
                yield busy
            return
        thread = threading.Thread(target=busy.run, name="busy", daemon=True)
        thread.start()
        try:
            yield busy
        finally:
            busy.stop()
            thread.join()
            self.clear()

    def clear(self) -> None:
        """Clear the line."""
        if self._is_drawn:
            self._stream.write(CLEAR_LINE)
            self._stream.flush()
            self._is_drawn = False


class BusyIndicator:
    """Redraws a line twice a second until stopped; the detail names the present step."""

    def __init__(self, terminal: Terminal, label: str) -> None:
        self._terminal = terminal
        self._label = label
        self._detail_text = ""
        self._ended = threading.Event()

    def set_detail(self, text: str) -> None:
        """Set the present step, shown behind the label."""
        self._detail_text = f": {text}"

    def progress_callback(self, what: str) -> Callable[[int, int], None]:
        """Return a function of (done, total) that shows the count of `what` as the detail."""
        return lambda done, total: self.set_detail(f"{what} {done}/{total}")

    def run(self) -> None:
        """Redraw until stopped; the body of the drawing thread."""
        begin_s = time.monotonic()
        while not self._ended.wait(BUSY_REDRAW_S):
            elapsed_s = time.monotonic() - begin_s
            self._terminal.show(f"{self._label}{self._detail_text} ... {elapsed_s:.0f} s")

    def stop(self) -> None:
        """Stop drawing."""
        self._ended.set()

"""Progress on a terminal; in a log, a line for what takes long."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

# A log tells of work that goes on for longer: nobody shall wait 2 s without a reason.
SLOW_AFTER_S = 1.5

# Its own level counts, not the root's: the root's handlers show whatever is logged here.
_logger = logging.getLogger("kinect-vo.announcements")
REDRAW_S = 0.1
BUSY_REDRAW_S = 0.5
CLEAR_LINE = "\r\x1b[K"
_logger.setLevel(logging.INFO)


def announce(text: str) -> None:
    """Log a line at level info, shown unless only errors are wanted (``log.level = "error"``)."""
    if logging.getLogger().level <= logging.WARNING:
        _logger.info("%s", text)


@contextmanager
def announce_if_slow(label: str) -> Iterator[None]:
    """Two lines if the block takes long: one when that is seen, and one when it is over."""
    begin_s = time.monotonic()
    timer = threading.Timer(SLOW_AFTER_S, announce, [f"{label} ..."])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        was_told = timer.finished.is_set()
        timer.cancel()
        timer.join()
        if was_told:
            announce(f"{label}: ended after {time.monotonic() - begin_s:.1f} s")


def clear_line(stream: TextIO) -> None:
    """Empty the line that a terminal's cursor is in; anything else is left as it is."""
    if stream.isatty():
        stream.write(CLEAR_LINE)
        stream.flush()


class Terminal:
    """One line on stderr that is drawn over and over, where stderr is a terminal."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._is_log = not self._stream.isatty()
        self._drawn_s = 0.0
        self._is_drawn = False

    def show(self, text: str) -> None:
        """Replace the line."""
        if self._is_log:
            return
        self._stream.write(f"{CLEAR_LINE}{text}")
        self._stream.flush()
        self._is_drawn = True

    def progress(self, label: str, done: int, total: int | None) -> None:
        """Replace the line by a count, at most ten times a second."""
        now_s = time.monotonic()
        if now_s - self._drawn_s < REDRAW_S and done != total:
            return
        self._drawn_s = now_s
        self.show(f"{label} {done}/{total} ({done / total:.0%})" if total else f"{label} {done}")

    def progress_callback(self, label: str) -> Callable[[int, int], None]:
        """`progress` under one label, for those who know only (done, total)."""
        return lambda done, total: self.progress(label, done, total)

    def write_line(self, text: str) -> None:
        """Leave a line that stays; in a log, a line of level info."""
        if self._is_log:
            announce(text)
            return
        self.clear()
        self._stream.write(f"{text}\n")
        self._stream.flush()

    @contextmanager
    def busy(self, label: str) -> Iterator["BusyIndicator"]:
        """Show that work of unknown length goes on: a line that counts the seconds.

        A log gets a line if it takes long, and another when it is over.
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
        """Take the line away."""
        if self._is_drawn:
            self._stream.write(CLEAR_LINE)
            self._stream.flush()
            self._is_drawn = False


class BusyIndicator:
    """Redraws a line twice a second until it is ended; `detail` says what is being done."""

    def __init__(self, terminal: Terminal, label: str) -> None:
        self._terminal = terminal
        self._label = label
        self._detail_text = ""
        self._ended = threading.Event()

    def set_detail(self, text: str) -> None:
        """What is being done now."""
        self._detail_text = f": {text}"

    def progress_callback(self, what: str) -> Callable[[int, int], None]:
        """`detail` for those who know only (done, total) of `what`."""
        return lambda done, total: self.set_detail(f"{what} {done}/{total}")

    def run(self) -> None:
        """Body of the thread that draws."""
        begin_s = time.monotonic()
        while not self._ended.wait(BUSY_REDRAW_S):
            elapsed_s = time.monotonic() - begin_s
            self._terminal.show(f"{self._label}{self._detail_text} ... {elapsed_s:.0f} s")

    def stop(self) -> None:
        """Draw no more."""
        self._ended.set()

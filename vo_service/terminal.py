"""Progress for a person at a terminal; in a log, only what is worth a line."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TextIO

from vo_service.announcements import announce

REDRAW_S = 0.1
BUSY_REDRAW_S = 0.5
# A log tells of work that goes on for longer: nobody shall wait 2 s without a reason.
LONG_S = 1.5
CLEAR_LINE = "\r\x1b[K"


def wipe(stream: TextIO) -> None:
    """Empty the line that a terminal's cursor is in; anything else is left as it is."""
    if stream.isatty():
        stream.write(CLEAR_LINE)
        stream.flush()


class Terminal:
    """One line on stderr that is drawn over and over, where stderr is a terminal."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self.is_log = not self._stream.isatty()  # otherwise a person watches
        self._drawn_s = 0.0
        self._is_drawn = False

    def show(self, text: str) -> None:
        """Replace the line."""
        if self.is_log:
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

    def counter(self, label: str) -> "Counter":
        """`progress` under one label, for those who know only (done, total)."""
        return Counter(self, label, LongWork(self, label))

    def say(self, text: str) -> None:
        """Leave a line that stays; in a log, a line of level info."""
        if self.is_log:
            announce(text)
            return
        self.clear()
        self._stream.write(f"{text}\n")
        self._stream.flush()

    @contextmanager
    def busy(self, label: str) -> Iterator["Busy"]:
        """Show that work of unknown length goes on: a line that counts the seconds.

        A log gets a line if it takes long, and another when it is over.
        """
        busy = Busy(self, label)
        thread = threading.Thread(target=busy.run, name="busy", daemon=True)
        thread.start()
        try:
            yield busy
        finally:
            busy.end()
            thread.join()
            self.clear()

    def clear(self) -> None:
        """Take the line away."""
        if self._is_drawn:
            self._stream.write(CLEAR_LINE)
            self._stream.flush()
            self._is_drawn = False


class LongWork:
    """Lines of a log for work that takes long: one once that is seen, and one when it is over."""

    def __init__(self, terminal: Terminal, label: str) -> None:
        self._terminal = terminal
        self._label = label
        self._begin_s = time.monotonic()
        self._is_told = False

    @property
    def elapsed_s(self) -> float:
        """Seconds since the work began."""
        return time.monotonic() - self._begin_s

    def goes_on(self) -> None:
        """Tell it, if it has taken long enough by now."""
        if self._terminal.is_log and not self._is_told and self.elapsed_s >= LONG_S:
            self._is_told = True
            announce(f"{self._label} ...")

    def end(self) -> None:
        """Tell how long it took, if it was told that it goes on."""
        if self._is_told:
            self._is_told = False
            announce(f"{self._label}: ended after {self.elapsed_s:.1f} s")


@dataclass(frozen=True)
class Counter:
    """Draws how far counted work is: called with (done, total)."""

    terminal: Terminal
    label: str
    work: LongWork

    def __call__(self, done: int, total: int) -> None:
        """So much is done."""
        self.terminal.progress(self.label, done, total)
        self.work.end() if done >= total else self.work.goes_on()


class Busy:
    """Redraws a line twice a second until it is ended; `detail` says what is being done."""

    def __init__(self, terminal: Terminal, label: str) -> None:
        self._terminal = terminal
        self._label = label
        self._detail = ""
        self._ended = threading.Event()

    def detail(self, text: str) -> None:
        """What is being done now."""
        self._detail = f": {text}"

    def run(self) -> None:
        """Body of the thread that draws."""
        work = LongWork(self._terminal, self._label)
        while not self._ended.wait(BUSY_REDRAW_S):
            self._terminal.show(f"{self._label}{self._detail} ... {work.elapsed_s:.0f} s")
            work.goes_on()
        work.end()

    def end(self) -> None:
        """Draw no more."""
        self._ended.set()

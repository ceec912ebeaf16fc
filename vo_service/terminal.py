"""Progress for a person at a terminal; silence in a log."""

import sys
import time
from typing import TextIO

REDRAW_S = 0.1


class Terminal:
    """One line on stderr that is drawn over and over. Silent unless stderr is a terminal."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._is_quiet = not self._stream.isatty()
        self._drawn_s = 0.0
        self._is_drawn = False

    def show(self, text: str) -> None:
        """Replace the line."""
        if self._is_quiet:
            return
        self._stream.write(f"\r\x1b[K{text}")
        self._stream.flush()
        self._is_drawn = True

    def progress(self, label: str, done: int, total: int | None) -> None:
        """Replace the line by a count, at most ten times a second."""
        now_s = time.monotonic()
        if now_s - self._drawn_s < REDRAW_S and done != total:
            return
        self._drawn_s = now_s
        self.show(f"{label} {done}/{total} ({done / total:.0%})" if total else f"{label} {done}")

    def clear(self) -> None:
        """Take the line away."""
        if self._is_drawn:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
            self._is_drawn = False
